# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The table of generated pages: commands, `pfd report` without a page, and the index derive from it.

To add a page: a row of PAGES, whose function `(folder, quick) -> paths` measures and writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
import json
from pathlib import Path
import time

from pfd_core.report.measure.processes import each
from pfd_core.report.measure.progress import show_line
from pfd_core.report.render.markdown import json_text, lines_of, write_text

FOLDER, QUICK_FOLDER = Path('pfd_report'), Path('pfd_report_quick')
INDEX = 'index.md'
QUICK = (
    '**Quick run** (`--quick`): few rounds, cases and states, to see that everything works. '
    'Its numbers are no results.'
)

# Errors whose message says what to do.
EXPECTED = (ValueError, OSError, ImportError, ArithmeticError, RuntimeError)
# The page that begins a quick run.
QUICK_FIRST = 'speed-against-error'


@dataclass(frozen=True)
class Page:
    """
    A generated page.

    Attributes
    ----------
    name : str
        Name of its files, NAME.md and NAME.json.
    command : str
        Arguments of `pfd report`.
    title : str
        Its content, for help and index.
    module : str
        Module of pfd_core.report with its function.
    function : str
        Name of the function of folder and quickness.
    also : tuple of str
        Names of further pages that it writes.
    clocks : bool
        Whether it measures times, which other work on the machine would change.

    """

    name: str
    command: str
    title: str
    module: str
    function: str = 'run'
    also: tuple[str, ...] = ()
    clocks: bool = False

    @property
    def kind(self) -> str:
        """The first word of the command."""
        return self.command.split()[0]

    def make(self, folder: Path, quick: bool = False) -> list[Path]:
        """Measure, write the files into a folder and return their paths."""
        run: Callable[..., list[Path]] = getattr(
            import_module(f'pfd_core.report.{self.module}'), self.function
        )
        paths = run(folder, quick=quick)
        for path in paths:
            if quick:
                _mark(path)
        return paths


PAGES: Sequence[Page] = (
    Page(
        'hard-cases',
        'hard-cases',
        'errors of ill-conditioned forward dynamics and motions',
        'hard_case_pages',
    ),
    Page(
        'derivatives',
        'derivatives',
        'errors of derivatives and linearised steps at the hard cases',
        'derivative_pages',
    ),
    Page(
        'distributions',
        'distributions',
        'errors and condition numbers over thousands of states of 11 arms, as box plots',
        'distribution_pages',
    ),
    Page(
        'mechanisms',
        'mechanisms',
        'errors of the default compared with pinocchio.aba',
        'mechanism_pages',
    ),
    Page(
        'speed-against-error',
        'speed --against-error',
        'time against error of every method, integrator and peer',
        'against_error_pages',
        clocks=True,
    ),
    Page(
        'controlled-arm',
        'controlled-arm',
        'time against error of a UR5 under a controller, and advice',
        'controlled_arm_pages',
        clocks=True,
    ),
    Page('speed', 'speed', 'times compared with other libraries', 'speed_pages', clocks=True),
)


def kinds() -> dict[str, Page]:
    """Return the first words of commands, each with the page of its shortest command."""
    found: dict[str, Page] = {}
    for one in PAGES:
        known = found.setdefault(one.kind, one)
        found[one.kind] = min(known, one, key=lambda page: len(page.command))
    return found


def page_of(command: str) -> Page:
    """Return the page of a command."""
    (found,) = (one for one in PAGES if one.command == command)
    return found


def make_all(folder: Path, quick: bool = False) -> Iterator[Path | str]:
    """
    Make every page and the index; progress goes to stderr, a line for each page.

    Pages with clocks come first, before others have warmed up the machine, and run alone. Other
    pages measure on all processors. Quick pages, whose times are no results, are made at once.

    Yields
    ------
    Path or str
        Each file, or one line about a page that could not be made.

    """
    start = time.monotonic()
    # Quickly the page that compiles longest, whose result others take from disk.
    first = (one.name == QUICK_FIRST if quick else one.clocks for one in PAGES)
    order = [PAGES[k] for _, k in sorted((not now, k) for k, now in enumerate(first))]
    attempts = [(one, folder, quick) for one in order]
    outcomes = each(_attempted, attempts, 'pages') if quick else map(_attempted, attempts)
    failed: list[str] = []
    for k, one in enumerate(order):
        show_line(f'{k + 1} of {len(order)}: {one.name}, {one.title}')
        files, error, seconds = next(outcomes)
        yield from files
        if error:
            failed.append(one.name)
            yield f'{one.name} was not made: {error}'
        show_line(f'   {seconds:.0f} s')
    index = write_text(folder, INDEX, index_text())
    if quick:
        _mark(index)
    yield index
    missing = f'; not made: {", ".join(failed)}' if failed else ''
    show_line(f'all pages: {time.monotonic() - start:.0f} s{missing}')


def _attempted(attempt: tuple[Page, Path, bool]) -> tuple[list[Path], str, float]:
    """Return the files of a page, the reason if it was not made, and the seconds it took."""
    one, folder, quick = attempt
    began, files, reason = time.monotonic(), list[Path](), ''
    try:
        files = one.make(folder, quick)
    except EXPECTED as error:
        reason = str(error)
    except Exception as error:
        # The other pages are made in spite of an error in one.
        reason = f'{type(error).__name__}: {error}; its traceback: pfd report {one.command}'
    return files, reason, time.monotonic() - began


def index_text() -> str:
    """Return the list of the pages with their commands, as Markdown."""
    rows = (
        [
            ', '.join(f'[{name}]({name}.md)' for name in (one.name, *one.also)),
            one.title,
            f'`pfd report {one.command}`',
        ]
        for one in PAGES
    )
    lines = lines_of(['page', 'shows', 'command'], rows)
    head = '# Generated pages\n\n`pfd report` makes all of them on this machine.\n\n'
    return head + '\n'.join(lines) + '\n'


def _mark(path: Path) -> None:
    """Write into a page, below its title, and into its data that the run was quick."""
    if path.suffix == '.md':
        title, _, rest = path.read_text(encoding='utf-8').partition('\n')
        path.write_text(f'{title}\n\n{QUICK}\n{rest}', encoding='utf-8')
    elif path.suffix == '.json':
        found = json.loads(path.read_text(encoding='utf-8'))
        found = found if isinstance(found, dict) else {'rows': found}
        path.write_text(json_text({'quick': True, **found}), encoding='utf-8')

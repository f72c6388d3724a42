# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of `pfd view` in a browser: the arm is there, the right way up, and moves."""

from __future__ import annotations

from pathlib import Path

from bridge import (
    ViewContent,
    ViewPlayer,
    export_view,
    fill_view,
    view_address,
    view_content,
    view_page,
)
from browser import needs_browser
from devtools import Page, opened, red
import numpy as np
import pytest
from view_models import STATE, joint_state, pushed_bag, text_message, urdf, visual, write_bag
from waiting import wait_until

pytestmark = [pytest.mark.slow, needs_browser]
# The arm hangs down for this time [s], and points up as long.
HANGING = 10.0
LEAST = 0.005
# Part of a picture that an arrow has at least.
ARROW = 0.0005


@pytest.fixture
def log(tmp_path: Path) -> ViewContent:
    """Return a log of a magenta pendulum."""
    magenta = '<material name="m"><color rgba="1 0 1 1"/></material>'
    box = visual('<box size="0.1 0.1 0.4"/>', '<origin xyz="0 0 -0.2"/>', magenta)
    states = [
        ('/joint_states', STATE, k, joint_state(k * HANGING, ['swing'], [position]))
        for k, position in enumerate((0.0, 2.9, 2.9))
    ]
    described = ('/robot_description', 'std_msgs/msg/String', 0, text_message(urdf(box)))
    return view_content(write_bag(tmp_path / 'bag', [described, *states]))


def arm_of(pixels: np.ndarray) -> np.ndarray:
    """Return where a picture is magenta, lit or in the shade."""
    red, green, blue = np.moveaxis(pixels.astype(int), 2, 0)
    return (np.minimum(red, blue) - green > 60) & (np.abs(red - blue) < 60)


def seen(shown: Page, other: np.ndarray | None = None) -> np.ndarray:
    """Return where the arm is, once it is there, and elsewhere than in another picture."""
    found = np.zeros(0)
    shares: list[float] = []

    def came() -> bool:
        nonlocal found
        found = arm_of(shown.pixels())
        shares[:] = found.mean(), 1.0 if other is None else (found ^ other).mean()
        return min(shares) > LEAST

    wait_until(came, lambda: f'parts that are magenta, and that moved: {shares}; {shown.console}')
    return found


def height(arm: np.ndarray) -> float:
    """Return the mean height of an arm in a picture, in pixels from the bottom."""
    return arm.shape[0] - float(np.nonzero(arm)[0].mean())


def test_the_arm_of_a_log_is_in_the_page_and_moves_with_time(
    log: ViewContent, tmp_path: Path
) -> None:
    with view_page(0, 'test') as server:
        player = ViewPlayer(server.gui, log.motion, fill_view(server, log))
        player.advance(0.0)
        with opened(view_address(server), tmp_path / 'profile') as shown:
            low = seen(shown)
            player.seek(HANGING)
            player.advance(0.0)
            high = seen(shown, low)
            assert shown.value('document.body.innerText').count('State forward') == 1
            assert shown.console == []
    assert height(high) > height(low) + 50


def test_the_exported_page_plays_from_disk_without_network(
    log: ViewContent, tmp_path: Path
) -> None:
    target = tmp_path / 'arm.html'
    export_view(log, None, target)
    with opened(target.as_uri(), tmp_path / 'profile') as shown:
        # It plays by itself, from its start and again and again.
        seen(shown, seen(shown))
        assert shown.console == []


@pytest.mark.long
def test_the_arrow_of_a_force_is_in_the_page_while_it_acts(tmp_path: Path) -> None:
    content = view_content(pushed_bag(tmp_path / 'bag'))
    with view_page(0, 'test') as server:
        show = fill_view(server, content)
        with opened(view_address(server), tmp_path / 'profile') as shown:
            for time_shown, acts in ((0.1, False), (0.3, True), (0.4, False), (0.2, True)):
                show(content.motion.time[round(10 * time_shown)])
                wait_until(
                    lambda acts=acts: (red(shown) > ARROW) == acts,
                    lambda at=time_shown: (at, shown.console),
                )
            assert shown.console == []

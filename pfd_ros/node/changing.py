# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of the arm's settings: checked, compiled on a separate thread, passed on in order.

A first payload needs new native code, which takes some tenths of a second to compile. A thread
compiles it before the event reaches the arm, so neither the stepping thread nor the executor waits
for it. Of the changes received meanwhile only the newest are applied. Between two compilations
the thread pauses, since it shares the interpreter with the stepping thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import threading
import time
from typing import Any

from pfd_ros.arm.changes import changed, encode_changes, payload_values
from pfd_ros.arm.commands import Validation
from pfd_ros.arm.engine import Engine
from pfd_ros.arm.events import Source, Verdict
from pfd_ros.arm.plant_settings import COMPILED, PAYLOAD
from pfd_ros.arm.scene import scene_of
from pfd_ros.arm.settings import Settings
from pfd_ros.messages.stamped import decode_inertia
from pfd_ros.node.receiving import Receiver

# A payload message has a hundred bytes; the arm rejects longer ones.
LONGEST_PAYLOAD = 1 << 12
# The compiler slows the stepping thread down, so it runs at most a fifth of the time: after each
# run it pauses for a multiple of its duration, s at most.
PAUSE, LONGEST_PAUSE = 4.0, 1.0
SUPERSEDED = Validation(Verdict.OVERFLOWED, 'superseded by a newer one before it was compiled')


@dataclass
class Changes:
    """Passes changes on to the arm, from any thread.

    They are validated by the arm's rules first; a rejected change is not recorded.

    Attributes
    ----------
    settings
        Settings of the arm after all accepted changes.
    """

    receiver: Receiver
    engine: Engine
    settings: Settings = field(init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _thread: threading.Thread | None = None
    # Values by field that wait for the compiler, with the message of a payload. A payload goes
    # first; later values of other fields wait in the second entry.
    _waiting: dict[Source, tuple[dict[str, Any], bytes]] = field(default_factory=dict)
    _passed: Settings = field(init=False)
    _rested: float = 0.0

    def __post_init__(self) -> None:
        """Start with the settings of the arm."""
        self.settings = self._passed = self.engine.settings

    def set(self, values_of: Callable[[Settings], dict[str, Any]]) -> None:
        """Apply new values by field, which may depend on the current settings.

        Raises
        ------
        ValueError
            If the arm rejects them, with the reason.
        """
        with self._lock:
            values = values_of(self.settings)
            settings = self._checked(values)
            if self._thread is not None or not COMPILED.isdisjoint(values):
                before, _ = self._waiting.get(Source.PARAMETERS, ({}, b''))
                self._wait(Source.PARAMETERS, before | values, b'')
            else:
                self._pass_on(values)
                self._passed = changed(self.engine.arm, self._passed, values)
            self.settings = settings

    def take_payload(self, data: bytes) -> None:
        """Pass on a payload message."""
        with self._lock:
            try:
                if len(data) > LONGEST_PAYLOAD:
                    raise ValueError
                values = payload_values(decode_inertia(data), self.engine.arm)
                settings = self._checked(values)
            except ValueError:
                # The arm rejects it, as a message of any other topic.
                self.receiver.receive(Source.PAYLOAD, data)
                return
            before, _ = self._waiting.pop(Source.PARAMETERS, ({}, b''))
            left = {name: value for name, value in before.items() if name not in PAYLOAD}
            if left:
                self._waiting[Source.PARAMETERS] = left, b''
            if Source.PAYLOAD in self._waiting:
                self.receiver.counts.add(Source.PAYLOAD, SUPERSEDED)
            self._wait(Source.PAYLOAD, values, data)
            self.settings = settings

    def _checked(self, values: dict[str, Any]) -> Settings:
        arm = self.engine.arm
        settings = changed(arm, self.settings, values)
        if not COMPILED.isdisjoint(values):
            if arm.failure:
                raise ValueError('the simulation has stopped')
            scene_of(settings, arm.order)
        return settings

    def _pass_on(self, values: dict[str, Any]) -> None:
        """Pass values on and wait for the result; a very slow arm applies them later."""
        validation = self.receiver.validation_of(Source.PARAMETERS, encode_changes(values))
        if validation is not None and validation.verdict is not Verdict.ACCEPTED:
            raise ValueError(f'{validation.verdict.label}: {validation.detail}')

    def _wait(self, source: Source, values: dict[str, Any], data: bytes) -> None:
        if self._thread is None:
            # It waits for the lock. Started before anything is kept: it may not start.
            thread = threading.Thread(target=self._compile_waiting, name='compiling')
            thread.start()
            self._thread = thread
        self._waiting[source] = values, data

    def _compile_waiting(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._thread = None
                    return
            time.sleep(max(0.0, self._rested - time.monotonic()))
            with self._lock:
                source = min(self._waiting, key=(Source.PAYLOAD, Source.PARAMETERS).index)
                values, data = self._waiting.pop(source)
            try:
                settings = changed(self.engine.arm, self._passed, values)
                if not COMPILED.isdisjoint(values):
                    self._prepare(settings)
            except Exception as error:
                # The arm would fail at it too.
                detail = f'not compiled: {type(error).__name__}: {error}'
                self.receiver.counts.add(source, Validation(Verdict.REFUSED, detail))
                with self._lock:
                    self.settings = self._passed
                continue
            self._passed = settings
            self.receiver.receive(source, data or encode_changes(values))

    def _prepare(self, settings: Settings) -> None:
        """Compile the plant of some settings, and set the end of the pause after it."""
        begun = time.monotonic()
        self.engine.arm.prepare(settings)
        ended = time.monotonic()
        self._rested = ended + min(PAUSE * (ended - begun), LONGEST_PAUSE)

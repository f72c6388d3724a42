# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page of `pfd view` in a browser: the arm is there, the right way up, and moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal
from typing import Any

from bridge import ShownLog, ViewPlayer, export_view, view_address, view_page
from devtools import Page, needs_browser, opened, red
import numpy as np
import pytest
from ros_processes import Peer, Processes, call
from view_models import STATE, WRENCH, described, joint_state, visual, wrench_message, write_bag
from waiting import wait_until

pytestmark = [pytest.mark.slow, needs_browser]
# The arm hangs down for this time [s], and points up as long.
HANGING = 10.0
# Parts of a picture: an arm, and an arrow.
LEAST, ARROW = 0.005, 0.0005
# Swiftshader draws each pixel on a processor.
SIZE = 1200, 750


@pytest.fixture
def log(tmp_path: Path) -> ShownLog:
    """Return a log of a magenta pendulum that is pushed while it points up."""
    magenta = '<material name="m"><color rgba="1 0 1 1"/></material>'
    box = visual('<box size="0.1 0.1 0.4"/>', '<origin xyz="0 0 -0.2"/>', magenta)
    messages: list[Any] = [described(box)]
    for k, position in enumerate((0.0, 2.9, 2.9)):
        state = joint_state(k * HANGING, ['swing'], [position])
        messages.append(('/joint_states', STATE, 10**9 * (k + 1), state))
        push = wrench_message('end', (9.0 if k == 1 else 0.0, 0.0, 0.0))
        messages.append(('/external_wrench', WRENCH, 10**9 * (k + 1), push))
    return ShownLog(write_bag(tmp_path / 'bag', messages), wrench_topic='/external_wrench')


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


def test_the_arm_of_a_log_is_in_the_page_and_moves_with_time_and_its_push_is_seen(
    log: ShownLog, tmp_path: Path
) -> None:
    with view_page(0, 'test') as server:
        player = ViewPlayer(server.gui, log.time, log.fill(server))
        player.advance(0.0)
        with opened(view_address(server), tmp_path / 'profile', SIZE) as shown:
            low = seen(shown)
            assert red(shown) < ARROW
            player.seek(HANGING)
            player.advance(0.0)
            high = seen(shown, low)
            wait_until(lambda: red(shown) > ARROW, lambda: shown.console)
            player.seek(2 * HANGING)
            player.advance(0.0)
            wait_until(lambda: red(shown) < ARROW, lambda: shown.console)
            text = shown.value('document.body.innerText')
            assert text.count('State forward') == 1
            assert 'Share' not in text
            assert shown.console == []
    assert height(high) > height(low) + 40


def test_the_exported_page_plays_from_disk_without_network(log: ShownLog, tmp_path: Path) -> None:
    target = tmp_path / 'arm.html'
    export_view(target, float(log.time[-1]), log.fill)
    assert not re.findall(r'(?:src|href)="(?:https?:)?//', target.read_text(encoding='utf-8'))
    with opened(target.as_uri(), tmp_path / 'profile', SIZE) as shown:
        # It plays by itself, from its start and again and again.
        seen(shown, seen(shown))
        assert shown.console == []


@pytest.mark.ros
@pytest.mark.long
def test_the_page_of_a_running_arm_shows_a_force_until_it_is_cleared(
    processes: Processes, peer_of: Callable[..., Peer], tmp_path: Path
) -> None:
    from geometry_msgs.msg import WrenchStamped
    from std_srvs.srv import Trigger

    arm = processes.python(
        *('-m', 'pfd_ros.cli.main', 'sim', '--robot', 'ur5', '--view', '--port', '0'),
        *('--ros-args', '-p', 'external_wrench:=true', '-p', 'outputs:=[tip_wrench]'),
    )
    arm.wait_for_text('receiving /joint_states')
    (url,) = re.findall(r'^(http://\S+) shows ', arm.text(), re.MULTILINE)
    peer = peer_of(processes)
    hand = peer.node.create_publisher(WrenchStamped, '/sim_arm/external_wrench', 1)
    peer.wait(lambda: hand.get_subscription_count() == 1)
    with opened(url, tmp_path / 'profile', SIZE) as shown:
        wait_until(lambda: 'Scale: 1 m = ' in (shown.value('document.body.innerText') or ''))
        assert red(shown) < ARROW
        message = WrenchStamped()
        message.header.frame_id = 'tool0'
        message.wrench.force.z = 60.0
        hand.publish(message)
        wait_until(lambda: red(shown) > ARROW)
        assert call(peer, Trigger, 'clear_external_wrench').success
        wait_until(lambda: red(shown) < ARROW)
        assert shown.console == []
    assert arm.end(signal.SIGINT) == 0

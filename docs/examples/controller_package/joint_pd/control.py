"""The control law, without ROS: so most tests need none."""

from __future__ import annotations

import numpy as np


class JointPD:
    """PD control along a minimum-jerk step from wherever the arm is to a goal.

        tau = stiffness (r(t) - q) + damping (dr/dt - qd)

    The arm compensates gravity by itself, as many arms with a torque interface do.

    Parameters
    ----------
    stiffness, damping
        Gains of each joint (n,), N m/rad and N m s/rad.
    goal
        Positions (n,), rad.
    duration
        Of the step, s.
    """

    def __init__(self, stiffness, damping, goal, duration: float) -> None:
        self.stiffness, self.damping = np.asarray(stiffness), np.asarray(damping)
        self.goal, self.duration = np.asarray(goal), duration
        self._begin = None

    def __call__(self, t: float, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Return the torques (n,) for a state at a time."""
        if self._begin is None:
            self._begin = t, np.array(q)
        begin, start = self._begin
        x = min((t - begin) / self.duration, 1.0)
        share = x**3 * (10 - 15 * x + 6 * x**2)
        rate = 30 * x**2 * (1 - x) ** 2 / self.duration
        reference = start + share * (self.goal - start)
        return self.stiffness * (reference - q) + self.damping * (rate * (self.goal - start) - qd)


# For a UR5: about 8 rad/s and well damped in each joint.
STIFFNESS = [600.0, 600.0, 400.0, 100.0, 100.0, 100.0]
DAMPING = [150.0, 150.0, 80.0, 20.0, 20.0, 20.0]

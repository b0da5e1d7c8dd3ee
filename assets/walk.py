"""People who walk. The sample's choreography: standing, a few steps, a full turn on one foot, standing again.

All is analytic in time: feet go from footprint to footprint, the hips follow them, legs are bent to reach, the
rest of the body swings along. Lengths in centimetres, times in seconds from the first frame, angles in radians,
column vectors; joint orientations are relative to the world's axes, which the skeleton is modelled in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plait.assets.character import ARM_ANGLE, Joint

DURATION = 4.0
SPIN_START, SPIN_END = 1.91, 2.86
LEG_STRETCH = 0.998  # of a leg's length; a straight knee would snap
FINE = 480.0  # samples a second in which paths are smoothed
LIFT_PITCH, LAND_PITCH = np.radians(32.0), np.radians(-14.0)
HEEL = -5.5  # [cm] where a heel lands, behind the ankle
SIDES = ("Left", "Right")


@dataclass(frozen=True)
class Swing:
    """A foot in the air from `start` to `end`, to the footprint whose ball lies at x, z [cm]."""

    start: float
    end: float
    x: float
    z: float
    height: float


@dataclass(frozen=True)
class Choreography:
    """What is walked.

    steps: for each side, swings in their order.  spin: start and end [s] of the full turn on the left foot.
    arms_out: [rad] of the hanging arms from the vertical.  staff: whether the right hand carries one.
    """

    steps: dict[str, tuple[Swing, ...]]
    spin: tuple[float, float]
    arms_out: float = np.radians(11.0)
    staff: bool = True


STEPS = {
    "Left": (Swing(0.81, 1.19, 7.5, 74.0, 5.0), Swing(1.53, 1.81, 7.0, 128.0, 4.0)),
    "Right": (Swing(0.39, 0.77, -7.5, 40.0, 5.0), Swing(1.20, 1.52, -7.5, 110.0, 5.0),
              Swing(SPIN_START + 0.02, SPIN_END + 0.02, -12.0, 128.0, 9.0)),
}  # fmt: skip
SAMPLE = Choreography(STEPS, (SPIN_START, SPIN_END))
NEVER = (1e6, 1e6 + 1.0)  # a spin that does not come


def animation(
    joints: tuple[Joint, ...], times: np.ndarray, choreography: Choreography = SAMPLE
) -> tuple[np.ndarray, np.ndarray]:
    """Local translations (time_count, joint_count, 3) [cm] and rotations (time_count, joint_count, 3, 3)."""
    world = Walk(joints, choreography).world(times)
    rest = np.array([joint.place for joint in joints])
    rotations = np.stack([world[joint.name] for joint in joints], axis=1)
    translations = np.empty((len(times), len(joints), 3))
    local = np.empty_like(rotations)
    for k, joint in enumerate(joints):
        if joint.parent < 0:
            translations[:, k], local[:, k] = world["place"], rotations[:, k]
        else:
            translations[:, k] = rest[k] - rest[joint.parent]
            local[:, k] = np.swapaxes(rotations[:, joint.parent], 1, 2) @ rotations[:, k]
    return translations, local


class Walk:
    """Paths of feet and hips, from which every joint's orientation follows."""

    def __init__(self, joints: tuple[Joint, ...], choreography: Choreography = SAMPLE) -> None:
        self._rest = {joint.name: joint.place for joint in joints}
        self._plan = choreography
        self._steps = choreography.steps
        self._spin_start, self._spin_end = choreography.spin
        last = max(swing.end for swings in self._steps.values() for swing in swings)
        self._stop = min(self._spin_start, last)
        self._times = np.arange(-1.0, max(DURATION, last) + 1.0, 1.0 / FINE)
        self._feet = {side: self._ankle(side, self._times) for side in SIDES}
        self._hips = self._hip_path()

    # --- feet -------------------------------------------------------------------------------------------------

    def footprint(self, side: str, number: int) -> np.ndarray:
        """(3,) the ball joint's place when the foot lies flat, after `number` steps."""
        ball = self._rest[side + "Toe"].copy()
        if number:
            swing = self._steps[side][number - 1]
            ball[[0, 2]] = swing.x, swing.z
        return ball

    def planted(self, side: str, times: np.ndarray) -> np.ndarray:
        """Number of the footprint the foot stands on, -1 in the air."""
        number = np.zeros(len(times), dtype=int)
        for k, swing in enumerate(self._steps[side]):
            number[times > swing.start] = -1
            number[times >= swing.end] = k + 1
        return number

    def pitch(self, side: str, times: np.ndarray) -> np.ndarray:
        """Of the foot, positive with the heel up."""
        result = np.zeros(len(times))
        for swing in self._steps[side]:
            result += LIFT_PITCH * smooth(times, swing.start - 0.2, swing.start)
            result += (LAND_PITCH - LIFT_PITCH) * smooth(times, swing.start, swing.end)
            result -= LAND_PITCH * smooth(times, swing.end, swing.end + 0.1)
        if side == "Left":
            result += np.radians(16.0) * smooth(times, self._spin_start, self._spin_start + 0.2)
            result -= np.radians(16.0) * smooth(times, self._spin_end - 0.25, self._spin_end)
        return result

    def _standing(self, side: str, number: int, times: np.ndarray) -> np.ndarray:
        """(time_count, 3) ankle of a foot on a footprint: it rolls on its heel or on its ball."""
        yaw, pitch = rotation_y(self.turned(times)), rotation_x(self.pitch(side, times))
        ankle_to_ball = self._rest[side + "Toe"] - self._rest[side + "Foot"]
        ankle_to_heel = np.array([0.0, -self._rest[side + "Foot"][1], HEEL])
        ball = self.footprint(side, number)
        heel = ball + apply(yaw, ankle_to_heel - ankle_to_ball)
        on_heel = self.pitch(side, times) < 0.0
        contact = np.where(on_heel[:, None], heel, ball)
        arm = np.where(on_heel[:, None], ankle_to_heel, ankle_to_ball)
        return contact - apply(yaw @ pitch, arm)

    def _ankle(self, side: str, times: np.ndarray) -> np.ndarray:
        """(time_count, 3)"""
        number = self.planted(side, times)
        result = np.empty((len(times), 3))
        for k in range(len(self._steps[side]) + 1):
            stands = number == k
            result[stands] = self._standing(side, k, times[stands])
        for k, swing in enumerate(self._steps[side]):
            flies = (times > swing.start) & (times < swing.end)
            result[flies] = self._flight(side, k, swing, times[flies])
        return result

    def _flight(self, side: str, number: int, swing: Swing, times: np.ndarray) -> np.ndarray:
        """From one footprint to the next, in a frame that turns with the body about the other foot."""
        ends = np.array([swing.start, swing.end])
        first = self._standing(side, number, ends)[0]
        last = self._standing(side, number + 1, ends)[1]
        pivot = self.footprint("Left", len(self._steps["Left"])) * (1.0, 0.0, 1.0)
        back = rotation_y(-self.turned(ends))
        first, last = back[0] @ (first - pivot), back[1] @ (last - pivot)
        share = smooth(times, swing.start, swing.end)[:, None]
        place = pivot + apply(rotation_y(self.turned(times)), first + share * (last - first))
        place[:, 1] += swing.height * bump(times, swing.start, swing.end)
        return place

    # --- hips -------------------------------------------------------------------------------------------------

    def _hip_path(self) -> np.ndarray:
        """(fine time, 3): between the feet, over the one that carries, as high as the legs reach."""
        times, left, right = self._times, self._feet["Left"], self._feet["Right"]
        weight = self._weight_on_left(times)[:, None]
        place = gaussian(weight * left + (1.0 - weight) * right, 0.1)
        forward = self._rest["Hips"] - 0.5 * (self._rest["LeftFoot"] + self._rest["RightFoot"])
        place += apply(rotation_y(self.turned(times)), forward * (0.0, 0.0, 1.0))
        place[:, 1] = 0.0
        orientation = self._hip_orientation(times)
        height = np.full(len(times), self._rest["Hips"][1] - 0.3)
        for side in SIDES:
            hip = place + apply(orientation, self._rest[side + "Thigh"] - self._rest["Hips"])
            across = self._feet[side] - hip
            reach = LEG_STRETCH * sum(self._leg_lengths(side))
            below = np.sqrt(np.maximum(reach**2 - across[:, 0] ** 2 - across[:, 2] ** 2, 0.0))
            height = np.minimum(height, across[:, 1] + below)
        place[:, 1] = lower_envelope(height, 0.16)
        return place

    def _weight_on_left(self, times: np.ndarray) -> np.ndarray:
        """0 to 1, the share of the body over the left foot."""
        fine = self._times  # whatever is asked for, it is smoothed at the one rate
        left, right = self.planted("Left", fine) >= 0, self.planted("Right", fine) >= 0
        weight = 0.5 + 0.14 * left - 0.14 * right
        weight[(fine > self._spin_start) & (fine < self._spin_end)] = 0.95
        return np.interp(times, fine, gaussian(weight, 0.08))

    def _hip_orientation(self, times: np.ndarray) -> np.ndarray:
        yaw = self.turned(times) + np.radians(7.0) * self._stride(times)
        walking = 1.0 - smooth(times, self._spin_start - 0.2, self._spin_start + 0.2)
        roll = np.radians(8.0) * (self._weight_on_left(times) - 0.5) / 0.28 * walking
        return rotation_y(yaw) @ rotation_z(0.5 * roll)

    def _stride(self, times: np.ndarray) -> np.ndarray:
        """How far the right foot is ahead of the left, in strides of 60 cm."""
        ahead = self._feet["Right"] - self._feet["Left"]
        yaw = self.turned(self._times)
        forward = ahead[:, 0] * np.sin(yaw) + ahead[:, 2] * np.cos(yaw)
        return np.interp(times, self._times, gaussian(forward, 0.06) / 60.0)

    def _leg_lengths(self, side: str) -> tuple[float, float]:
        hip, knee, ankle = (self._rest[side + name] for name in ("Thigh", "Shin", "Foot"))
        return float(np.linalg.norm(knee - hip)), float(np.linalg.norm(ankle - knee))

    # --- the whole body ---------------------------------------------------------------------------------------

    def world(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Joint name -> (time_count, 3, 3) orientation; "place" -> (time_count, 3) of the hips."""
        result = {"place": sample(times, self._times, self._hips), "Hips": self._hip_orientation(times)}
        self._trunk(times, result)
        for side in SIDES:
            self._leg(side, times, result)
            self._arm(side, times, result)
        return result

    def _trunk(self, times: np.ndarray, world: dict[str, np.ndarray]) -> None:
        stride = self._stride(times)
        going = smooth(times, 0.3, 0.75) - smooth(times, self._stop - 0.1, self._stop + 0.4)
        wind_up = np.radians(-14.0) * bump(times, self._spin_start - 0.3, self._spin_start + 0.25)
        height = sample(times, self._times, self._hips)[:, 1]
        nod = np.radians(0.8) * (height - self._rest["Hips"][1]) + np.radians(3.0) * going
        for share, name in zip((0.35, 0.7, 1.0), ("Spine", "Chest", "UpperChest"), strict=True):
            yaw = (
                self.turned(times + 0.012 * share)
                + np.radians(7.0) * stride * (1.0 - 1.9 * share)
                + share * wind_up
            )
            lean = np.radians(3.5) * share * going
            world[name] = rotation_y(yaw) @ rotation_x(lean)
        world["Neck"] = rotation_y(self.turned(times + 0.016) + 0.5 * wind_up) @ rotation_x(0.5 * nod + 0.01)
        world["Head"] = rotation_y(self.turned(times + 0.02) + 0.2 * wind_up) @ rotation_x(-0.6 * nod)

    def _leg(self, side: str, times: np.ndarray, world: dict[str, np.ndarray]) -> None:
        """Two bones from the hip to the ankle; the knee bends in the plane of the foot's direction."""
        hip = world["place"] + apply(world["Hips"], self._rest[side + "Thigh"] - self._rest["Hips"])
        ankle = self._ankle(side, times)
        upper, lower = self._leg_lengths(side)
        axis = ankle - hip
        length = np.linalg.norm(axis, axis=1)
        if np.any(length > 0.9999 * (upper + lower)):
            raise ValueError(f"{side} leg does not reach the ground at {times[np.argmax(length)]:.2f} s")
        axis /= length[:, None]
        yaw = rotation_y(self.turned(times) + (0.08 if side == "Left" else -0.08))
        ahead = apply(yaw, np.array([0.0, 0.0, 1.0]))
        ahead -= axis * np.einsum("ij,ij->i", ahead, axis)[:, None]
        ahead /= np.linalg.norm(ahead, axis=1)[:, None]
        along = (upper**2 - lower**2 + length**2) / (2.0 * length)
        out = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
        knee = hip + axis * along[:, None] + ahead * out[:, None]
        sideways = np.cross(ahead, axis)
        for name, start, end in (("Thigh", hip, knee), ("Shin", knee, ankle)):
            child = {"Thigh": "Shin", "Shin": "Foot"}[name]
            bone = self._rest[side + child] - self._rest[side + name]
            world[side + name] = aim(end - start, sideways) @ aim(bone[None], np.array([[1.0, 0.0, 0.0]]))[0].T
        foot_yaw, pitch = rotation_y(self.turned(times)), self.pitch(side, times)
        world[side + "Foot"] = foot_yaw @ rotation_x(pitch)
        # With the heel up the toes stay flat, and nearly so in the air; else they go with the foot.
        in_air = np.zeros(len(times))
        for swing in self._steps[side]:
            in_air += bump(times, swing.start, swing.end)
        world[side + "Toe"] = foot_yaw @ rotation_x(np.where(pitch > 0.0, 0.4 * in_air * pitch, pitch))

    def _arm(self, side: str, times: np.ndarray, world: dict[str, np.ndarray]) -> None:
        sign = 1.0 if side == "Left" else -1.0
        chest = world["UpperChest"]
        spinning = smooth(times, self._spin_start, self._spin_start + 0.35) - smooth(
            times, self._spin_end - 0.25, self._spin_end + 0.45
        )
        swing = sign * np.radians(34.0) * self._stride(times)
        world[side + "Clavicle"] = chest
        if side == "Left" or not self._plan.staff:
            outward = self._plan.arms_out + np.radians(38.0) * spinning
            flex = np.radians(10.0) + 0.5 * np.maximum(swing, 0.0) + np.radians(25.0) * spinning
        else:  # carries the staff
            swing = 0.3 * swing - np.radians(6.0)
            outward = np.radians(16.0) + np.radians(6.0) * spinning
            flex = np.radians(84.0) + 0.0 * times
        lower = rotation_z(-sign * (ARM_ANGLE - outward))
        world[side + "UpperArm"] = chest @ rotation_x(-swing) @ lower
        world[side + "Forearm"] = chest @ rotation_x(-swing - flex) @ lower
        world[side + "Hand"] = world[side + "Forearm"]
        if side == "Right" and self._plan.staff:
            # The fist keeps the staff upright, a little forward.
            upright = rotation_x(np.full(len(times), np.radians(-84.0)))
            world[side + "Hand"] = rotation_y(self.turned(times)) @ upright @ lower

    def turned(self, times: np.ndarray) -> np.ndarray:
        """The body's heading: one full turn to its own left, fastest half way."""
        u = np.clip((times - self._spin_start) / (self._spin_end - self._spin_start), 0.0, 1.0)
        return 2.0 * np.pi * u * u * (3.0 - 2.0 * u)


def smooth(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """0 before, 1 after, between them with no jump in velocity or acceleration (minimum jerk)."""
    u = np.clip((times - start) / (end - start), 0.0, 1.0)
    return u**3 * (10.0 + u * (6.0 * u - 15.0))


def bump(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """0 outside, up to 1 half way, smooth like `smooth`."""
    middle = 0.5 * (start + end)
    return smooth(times, start, middle) - smooth(times, middle, end)


def gaussian(values: np.ndarray, width: float) -> np.ndarray:
    """Values sampled `FINE` times a second, smoothed over time; the ends are continued."""
    reach = int(np.ceil(4.0 * width * FINE))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (width * FINE)) ** 2)
    return _convolve(values, kernel / kernel.sum(), reach)


def lower_envelope(values: np.ndarray, half_width: float) -> np.ndarray:
    """Smooth, and nowhere above `values`: the least over a window, then averaged over the same window."""
    reach = int(half_width * FINE)
    padded = np.pad(values, reach, mode="edge")
    least = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).min(axis=1)
    kernel = np.cos(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * reach + 1)) ** 2
    return _convolve(least, kernel / kernel.sum(), reach)


def _convolve(values: np.ndarray, kernel: np.ndarray, reach: int) -> np.ndarray:
    columns = values.reshape(len(values), -1)
    padded = np.pad(columns, ((reach, reach), (0, 0)), mode="edge")
    smoothed = np.column_stack([np.convolve(column, kernel, mode="valid") for column in padded.T])
    return smoothed.reshape(values.shape)


def sample(times: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(times, at, column) for column in values.T])


def apply(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("tij,...tj->...ti", rotations, np.broadcast_to(vectors, (len(rotations), 3)))


def aim(axis: np.ndarray, sideways: np.ndarray) -> np.ndarray:
    """(n, 3, 3), columns: the axis, what is left of `sideways` across it, and their cross product."""
    first = axis / np.linalg.norm(axis, axis=1)[:, None]
    second = sideways - first * np.einsum("ij,ij->i", sideways, first)[:, None]
    second = second / np.linalg.norm(second, axis=1)[:, None]
    return np.stack([first, second, np.cross(first, second)], axis=2)


def rotation_x(angles: np.ndarray) -> np.ndarray:
    return _rotation(angles, 1, 2)


def rotation_y(angles: np.ndarray) -> np.ndarray:
    return _rotation(angles, 2, 0)


def rotation_z(angles: np.ndarray) -> np.ndarray:
    return _rotation(angles, 0, 1)


def _rotation(angles: np.ndarray, first: int, second: int) -> np.ndarray:
    """(n, 3, 3): turns axis `first` towards axis `second`."""
    angles = np.asarray(angles, float)
    result = np.tile(np.eye(3), (len(angles), 1, 1))
    result[:, first, first] = result[:, second, second] = np.cos(angles)
    result[:, second, first] = np.sin(angles)
    result[:, first, second] = -result[:, second, first]
    return result


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(time_count, n, 4) w, x, y, z of rotations (time_count, n, 3, 3), continuous in time.

    From the symmetric matrix of which the quaternion is the eigenvector of the largest eigenvalue (Bar-Itzhack
    2000): its column with the largest diagonal entry, which for a rotation is that eigenvector.
    """
    m = rotations
    trace = np.trace(m, axis1=-2, axis2=-1)
    products = np.empty((*m.shape[:-2], 4, 4))  # 4 q q^T
    products[..., 0, 0] = 1.0 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[..., i + 1, i + 1] = 1.0 + 2.0 * m[..., i, i] - trace
        products[..., 0, i + 1] = products[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        products[..., i + 1, j + 1] = products[..., j + 1, i + 1] = m[..., i, j] + m[..., j, i]
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    result = np.take_along_axis(products, largest[..., None, None], axis=-1)[..., 0]
    result /= np.linalg.norm(result, axis=-1, keepdims=True)
    turns_over = np.einsum("tnk,tnk->tn", result[1:], result[:-1]) < 0.0
    result[1:] *= np.where(np.cumsum(turns_over, axis=0) % 2 == 1, -1.0, 1.0)[..., None]
    return result * np.where(result[:1, :, :1] < 0.0, -1.0, 1.0)

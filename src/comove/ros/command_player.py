"""Player of joint commands that brakes where the next one is late. It runs under ROS's own Python.

Commands are points on a course on which arms hold their payload together. A sudden stop would be as hard as the
motors are, and joints that brake each by itself would tear at the payload. So the player goes on along the parabola
through the last three commands, ever more slowly: it departs from the course by the third order of the way to rest.
"""

from __future__ import annotations

from collections import deque

Joints = list[float]

STILL = 1e-7  # rad or m a period, below which joints are at rest


class CommandPlayer:
    """Player of commands, one a period.

    Parameters
    ----------
    position : list, joints at which it begins, at rest [rad]
    period : time between commands [s]
    velocity, acceleration : lists, limits of the joints [rad/s, rad/s^2]

    Attributes
    ----------
    run : number of the sequence of commands that it plays; another one begins when it has braked
    why : reason why it brakes or has braked; empty if it plays
    """

    SPARE = 1.5  # times the speed limit, that a command may ask for
    SHARE = 0.9  # of the limits of acceleration, with which it brakes
    FLATTER = (1.0, 0.75, 0.5, 0.25, 0.0)  # shares of a parabola's bend

    def __init__(self, position: Joints, period: float, velocity: Joints, acceleration: Joints):
        self.period, self.velocity, self.acceleration = period, velocity, acceleration
        self.most = [self.SPARE * limit * period for limit in velocity]
        self.run, self.why = 0, ""
        self.waiting: deque[tuple[int, Joints]] = deque()
        self.played: deque[Joints] = deque([list(position)] * 3, 3)
        self.way: deque[Joints] = deque()

    @property
    def position(self) -> Joints:
        """Return the joints that were commanded last."""
        return self.played[-1]

    @property
    def is_resting(self) -> bool:
        """Return whether it rests, and no command waits."""
        before, last = self.played[1], self.played[2]
        return not (self.waiting or self.way) and all(
            abs(b - a) <= STILL for a, b in zip(before, last, strict=True)
        )

    @property
    def has_braked(self) -> bool:
        """Return whether it has come to rest, and waits for another sequence."""
        return bool(self.why) and not self.way

    def put(self, run: int, number: int, position: Joints) -> None:
        """Take the next command of a sequence. Those of a braked sequence are ignored."""
        if run == self.run + 1 and self.has_braked:
            self.run, self.why = run, ""
        if run != self.run or self.why:
            return
        last = self.waiting[-1][1] if self.waiting else self.position
        steps = [abs(b - a) for a, b in zip(last, position, strict=True)]
        if all(step <= most for step, most in zip(steps, self.most, strict=True)):  # false of NaN
            self.waiting.append((number, position))
        else:
            self.brake("a command jumps")

    def brake(self, why: str) -> None:
        """Come to rest from now on."""
        if not self.why:
            self.why = why
            self.waiting.clear()
            self.way.extend(self.way_to_rest(list(self.played)))

    def tick(self) -> tuple[Joints, int]:
        """Return the joints to command now, and the command's number. It is -1 if it is none of those put in."""
        number, position = -1, self.position
        if not (self.why or self.waiting or self.is_resting):
            self.brake("the next command is late")
        if self.way:
            position = self.way.popleft()
        elif self.waiting:
            number, position = self.waiting.popleft()
        self.played.append(position)
        return position, number

    def way_to_rest(self, last: list[Joints]) -> list[Joints]:
        """Return the way to rest after three commands, along their parabola.

        All joints need the same time. Where some would leave their limits of speed or acceleration, the parabola is
        made flatter.
        """
        a, b, c = last
        rates = [(z - y) for y, z in zip(b, c, strict=True)]
        bends = [(z - y) - (y - x) for x, y, z in zip(a, b, c, strict=True)]
        limits = [self.SHARE * limit * self.period**2 for limit in self.acceleration]
        # Joints that already change their speed have less left for braking, but never less than half.
        spent = [max(m - abs(w), 0.5 * m) for w, m in zip(bends, limits, strict=True)]
        periods = max(abs(v) / m for v, m in zip(rates, spent, strict=True))
        if periods <= 0.0:
            return []
        n = int(periods) + 1
        for share in self.FLATTER:
            joints = [_braked(v, share * w, n) for v, w in zip(rates, bends, strict=True)]
            if all(self.fits(i, rates[i], bends[i], moved) for i, moved in enumerate(joints)):
                break
        return [[z + moved[k] for z, moved in zip(c, joints, strict=True)] for k in range(n)]

    def fits(self, joint: int, rate: float, bend: float, moved: list[float]) -> bool:
        """Return whether a joint keeps its limits on a way to rest.

        It may use what it already uses.
        """
        speeds = [rate, *(y - x for x, y in zip([0.0, *moved], moved, strict=False))]
        most = max(self.velocity[joint] * self.period, abs(rate)) + STILL
        hardest = max(self.acceleration[joint] * self.period**2, abs(bend)) + STILL
        return all(abs(v) <= most for v in speeds) and all(
            abs(v - u) <= hardest for u, v in zip(speeds, speeds[1:], strict=False)
        )

    def horizon(self) -> list[Joints]:
        """Return the next commands, and the way to rest after them."""
        if self.why:
            return list(self.way) or [self.position]
        coming = [position for _, position in self.waiting]
        last = ([*self.played, *coming])[-3:]
        return coming + self.way_to_rest(last) or [self.position]


def _braked(rate: float, bend: float, n: int) -> list[float]:
    """Return how far a joint gets in each of n periods.

    It goes along a parabola, ever more slowly.
    """
    found = []
    for k in range(1, n + 1):
        s = k - 0.5 * k * k / n  # periods of the course that are gone
        found.append(rate * s + 0.5 * bend * s * (s + 1.0))
    return found

"""The keys of the viewer: what each does, and the text in the window that says so."""

from __future__ import annotations

import mujoco

SLOWEST, FASTEST = 1 / 64, 64.0  # times real time

# key codes are GLFW's, told here so that no screen is needed to import this
PAUSE, STEP, NEXT, SLOWER, FASTER, HELP = 32, 262, 257, 45, 61, 297
_SAME = {333: SLOWER, 334: FASTER, 335: NEXT}  # of the number pad

KEYS = (
    ("Space", "pause, go on"),
    ("Right arrow", "one step, while paused"),
    ("-  =", "half, twice as fast"),
    ("Enter", "next episode"),
    ("[  ]", "other cameras"),
    ("Esc", "free camera: drag, scroll"),
    ("Tab", "MuJoCo's panels"),
    ("F1", "MuJoCo's own keys"),
    ("F8", "hide or show these"),
)
"""What is done by which key; [ ], Esc, Tab and F1 are MuJoCo's own."""

Text = tuple[int, int, str, str]
"""What `mujoco.viewer.Handle.set_texts` takes: font, place, left and right column."""


class Keys:
    """What the keys have asked for. The viewer's thread presses them, the simulation's looks.

    Attributes:
        paused: whether simulated time stands still.
        speed: simulated seconds a second of wall time.
        skipping: whether the episode is to end; whoever ends it sets it to False.
        shown: whether the keys are explained in the window.
    """

    def __init__(self, speed: float = 1.0):
        self.paused, self.skipping, self.shown = False, False, True
        self.speed = speed
        self._steps = 0

    def press(self, code: int) -> None:
        """Do what the key of that GLFW code does; other keys do nothing."""
        code = _SAME.get(code, code)
        if code == PAUSE:
            self.paused, self._steps = not self.paused, 0
        elif code == STEP and self.paused:
            self._steps += 1
        elif code == NEXT:
            self.skipping = True
        elif code == SLOWER:
            self.speed = max(0.5 * self.speed, SLOWEST)
        elif code == FASTER:
            self.speed = min(2.0 * self.speed, FASTEST)
        elif code == HELP:
            self.shown = not self.shown

    def holds(self) -> bool:
        """Return whether the simulation must wait; a step that was asked for is taken off."""
        if not self.paused or self.skipping:
            return False
        if self._steps:
            self._steps -= 1
            return False
        return True

    def texts(self, seconds: float) -> list[Text]:
        """Return what to write into the window, at a simulated time (s)."""
        names, values = ["time", "speed"], [f"{seconds:.1f} s", f"{self.speed:g}x"]
        if self.paused:
            names.append("paused")
            values.append("")
        corner = mujoco.mjtGridPos
        texts = [_text(corner.mjGRID_TOPLEFT, list(zip(names, values, strict=True)))]
        keys = KEYS if self.shown else KEYS[-1:]
        return [*texts, _text(corner.mjGRID_BOTTOMLEFT, keys)]


def _text(
    corner: mujoco.mjtGridPos, rows: list[tuple[str, str]] | tuple[tuple[str, str], ...]
) -> Text:
    left, right = zip(*rows, strict=True)
    return int(mujoco.mjtFont.mjFONT_NORMAL), int(corner), "\n".join(left), "\n".join(right)

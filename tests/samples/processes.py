"""Processes that tests start and interrupt."""

from __future__ import annotations

import signal


def heed_ctrl_c() -> None:
    """Take Ctrl-C as a terminal's program does; to be called in the child (`preexec_fn`).

    A shell's background jobs, and `nohup`, begin with SIGINT ignored, and hand that on.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)

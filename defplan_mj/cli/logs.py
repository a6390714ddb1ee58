"""`defplan compare` and `defplan replay`: what can be learnt from logs alone."""

from __future__ import annotations

import argparse

from defplan_mj.cli.console import Console, table


def compare(arguments: argparse.Namespace, console: Console) -> int:
    """Compare surrogate and reduced dynamics over the logs; optionally draw it."""
    from defplan_mj.log.compare import DRIFT_COLUMNS, compare_logs

    comparison = compare_logs(arguments.log)
    for episode in comparison.episodes:
        if episode.fault:
            console.say(f"defplan: log {episode.path} is {episode.fault}: used up to there")
    data = comparison.to_json()
    if arguments.output:
        comparison.plot(arguments.output)
        data["plot"] = str(arguments.output)
    text = [
        table(
            comparison.columns, comparison.table(), "Surrogate against reduced dynamics, per cycle"
        ),
        table(DRIFT_COLUMNS, comparison.drift_rows(), "Logs"),
    ]
    console.result(data, "\n\n".join(text))
    return 0


def replay(arguments: argparse.Namespace, console: Console) -> int:
    """Simulate a log again; the exit code is 0 only if every bit is the same."""
    from defplan_mj.log.reader import read_log
    from defplan_mj.log.replay import replay_log, write_video

    log = read_log(arguments.log)
    with console.progress() as progress:
        result = replay_log(log, progress)
        data = result.to_json()
        if arguments.video:
            progress("drawing the video", 0.0)
            write_video(log, arguments.video, camera=arguments.camera)
            progress("drawing the video", 1.0)
            data["video"] = str(arguments.video)
    console.result(data, result.sentence())
    return 0 if result.identical else 1

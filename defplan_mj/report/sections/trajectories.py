"""The report's section on the paths of logged episodes: the paper's Fig. 6."""

from __future__ import annotations

from defplan_mj.log.reader import EpisodeLog
from defplan_mj.report.content import Figures, Missing, Section, drawing, video
from defplan_mj.report.figures.planning import episode_figures, overview_figures
from defplan_mj.report.figures.views import PICTURES
from defplan_mj.report.material import Material

MANY = 6  # episodes that call for an overview


def trajectory_section(material: Material) -> Section:
    """Return the paths of logged episodes, the paper's Fig. 6."""
    section = Section("trajectories", "Trajectories")
    logs, dynamics = material.logs, material.dynamics
    faults = [text for name, text in material.faults.items() if name.endswith(".mcap")]
    section.blocks += [Missing(f"{text}.") for text in faults]
    if not logs and not faults:
        section.blocks.append(Missing("No episode was logged yet (*.mcap)."))
    if not logs or dynamics is None:
        return section
    film = material.folder / "episode.mp4"
    if film.is_file():
        section.blocks.append(
            video(
                film,
                "The start of an episode as MuJoCo draws it; white: the way of the centre of mass, red: the "
                "target in its goal radius.",
            )
        )
    groups: dict[str, list[EpisodeLog]] = {}
    for log in logs:
        groups.setdefault(log.path.stem.rstrip("0123456789").rstrip("-_") or "episodes", []).append(
            log
        )
    for name, group in groups.items():
        pictures = PICTURES[group[0].space]
        if len(group) >= MANY:
            section.blocks.append(
                Figures(
                    [drawing(figure) for figure in overview_figures(group)],
                    f"All {len(group)} logged {name} episodes in one picture{pictures.overview_sides}: "
                    "paths from the common start (black dot) to the targets (red). Every episode has its own "
                    "obstacles (blue): a path may cross those of another.",
                )
            )
        # what failed is shown first
        most = pictures.shown
        shown = sorted(group, key=lambda log: log.outcome == "success")[:most]
        more = f" ({len(shown)} of {len(group)}, failures first)" if len(group) > most else ""
        section.blocks.append(
            Figures(
                [drawing(figure) for log in shown for figure in episode_figures(log, dynamics)],
                f"Logged {name} episodes{more}, {pictures.episode_sides}: path of the centre of mass (green), "
                "silhouettes of the body on its way (black), obstacles (blue; a moving one where it "
                "is at the end, dotted where it began), target within its goal radius (red).",
            )
        )
    return section

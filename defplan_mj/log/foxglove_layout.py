"""A layout for Foxglove and Lichtblick: the scene, and plots whose lines have names.

`foxglove-layout.json` beside this module is the one of a swimmer of five modes and three gaits;
`defplan export LOG --layout FILE` writes the one of a log.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from defplan_mj.log import channels, schemas
from defplan_mj.log.reader import EpisodeLog

SHIPPED = Path(__file__).with_name("foxglove-layout.json")


def layout(modes: int, gaits: Sequence[str]) -> dict[str, Any]:
    """Return a layout, as its JSON file holds it, for a body of that many modes with gaits of those names."""
    places = {label: i for i, label in enumerate(schemas.state_labels(modes))}

    def state(label: str, name: str = "") -> tuple[str, str]:
        return name or label, f"{channels.STATE}.values[{places[label]}]"

    def numbers(topic: str, *names: str) -> list[tuple[str, str]]:
        return [(name, f"{topic}.values[{k}]") for k, name in enumerate(names)]

    shape = [*schemas.shape_labels(modes), *(f"u{i + 1}" for i in range(modes))]
    panels: dict[str, Any] = {
        "3D!scene": _scene(),
        "Plot!shape": _plot("shape q and its target u", [state(label) for label in shape]),
        "Plot!speed": _plot(
            "velocity, m/s", [state(label, f"{label}, m/s") for label in ("vx", "vy", "vz")]
        ),
        "Plot!clearance": _plot("clearance, m", numbers(channels.CONTACTS, "clearance, m")),
        "Plot!gait": _plot("gait and phase", numbers(channels.GAIT, "gait", "phase")),
        "Plot!values": _plot("planner's values", numbers(channels.VALUES, *gaits)),
        "Plot!reward": _plot("reward, m^2", numbers(channels.REWARD, "reward, m^2")),
    }
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "splitPercentage": 60,
            "first": "3D!scene",
            "second": _column([name for name in panels if name.startswith("Plot!")]),
        },
    }


def layout_of(log: EpisodeLog) -> dict[str, Any]:
    """Return the layout of a log; gaits that it does not name have numbers."""
    names = log.task_names or [f"gait {k}" for k in range(log.values.shape[1])]
    return layout(log.target_shapes.shape[1], names)


def text(data: dict[str, Any]) -> str:
    """Return a layout as its file holds it."""
    return json.dumps(data, indent=1) + "\n"


def _scene() -> dict[str, Any]:
    shown = [channels.SCENE, channels.MESH, channels.LASER, channels.LASER_POINTS]
    topics: dict[str, Any] = {topic: {"visible": True} for topic in [*shown, channels.ARROWS]}
    for topic in (channels.LASER, channels.LASER_POINTS):
        topics[topic] |= {"colorMode": "flat", "flatColor": "#d98a1fff", "pointSize": 6}
    topics[channels.COM] = {"visible": False}
    topics[channels.SURROGATE] = {"visible": True, "axisScale": 0.3}
    return {
        "followMode": "follow-position",
        "followTf": schemas.ROBOT_FRAME,
        "cameraState": {
            "perspective": True,
            "distance": 8,
            "phi": 55,
            "thetaOffset": 90,
            "targetOffset": [0, 0, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.05,
            "far": 500,
        },
        "scene": {"backgroundColor": "#dfe9ee", "transforms": {"showLabel": False}},
        "transforms": {f"frame:{schemas.ROBOT_FRAME}": {"visible": False}},
        "topics": topics,
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid",
                "instanceId": "grid",
                "label": "metres",
                "visible": True,
                "frameId": schemas.WORLD_FRAME,
                "size": 60,
                "divisions": 60,
                "lineWidth": 1,
                "color": "#8aa0aa66",
                "position": [0, 0, -1],
                "rotation": [0, 0, 0],
            }
        },
    }


def _plot(title: str, paths: list[tuple[str, str]]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [
            {"value": value, "label": name, "enabled": True, "timestampMethod": "receiveTime"}
            for name, value in paths
        ],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "xAxisVal": "timestamp",
        # both programs keep a title of their own
        "foxglovePanelTitle": title,
        "lichtblickPanelTitle": title,
    }


def _column(panels: list[str]) -> Any:
    """Return panels one below the other, all of the same height."""
    if len(panels) == 1:
        return panels[0]
    return {
        "direction": "column",
        "splitPercentage": 100 / len(panels),
        "first": panels[0],
        "second": _column(panels[1:]),
    }

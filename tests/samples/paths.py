"""Where things are in the source tree."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ROOT / "tasks" / "assets"
EXAMPLES = ROOT / "docs" / "examples"

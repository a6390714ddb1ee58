"""defplan: motion planning for soft robots, hosted by MuJoCo."""

import warnings

__version__ = "0.2.0"

# dm_control tries GLFW on import, even where nothing will be drawn; without a screen it says so.
for _said in ("DISPLAY environment variable is missing", "Failed to open display"):
    warnings.filterwarnings("ignore", message=f".*{_said}")

from defplan_mj.host.on_import import keep_triton_out, load_plugin_with_mujoco  # noqa: E402  after the filter
from defplan_mj.rl.register import register_with_gymnasium  # noqa: E402

load_plugin_with_mujoco()  # it is not imported for that, either
keep_triton_out()
register_with_gymnasium()  # ids for gymnasium.make; it is not imported for that

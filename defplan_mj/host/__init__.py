"""MuJoCo as the host: engine plugin, scene, laser, contact queries, skin, dm_control environments."""

import warnings

# dm_control tries GLFW on import even where nothing will be drawn; without a screen it says so.
warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")

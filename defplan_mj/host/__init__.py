"""MuJoCo as the host: engine plugin, scene, laser, contact queries, skin, dm_control environments."""

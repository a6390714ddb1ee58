"""The soft body: from a mesh file to modes, rotation-strain coordinates, reduction and drag points."""

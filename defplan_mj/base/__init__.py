"""What every other package stands on: errors, files, threads, rotations, the plane and space. It imports none."""

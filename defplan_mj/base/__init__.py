"""What every other package stands on: errors, files, threads, progress, rotations. It imports none of them."""

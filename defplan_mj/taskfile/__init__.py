"""A task as a file (TOML): read with a sentence for what is wrong, written with comments, guessed from a mesh."""

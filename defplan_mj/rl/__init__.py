"""The suite's tasks as Gymnasium environments: `gymnasium.make("defplan/FishSwim-v0")`."""

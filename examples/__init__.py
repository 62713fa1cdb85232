"""Examples: axes, a plant, a notebook, and the demo."""

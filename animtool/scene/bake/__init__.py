"""The bake: plan, sample and write takes."""

"""The rig in the model: how it is used, whether it is rigid and in time, and what holds it when it is not."""

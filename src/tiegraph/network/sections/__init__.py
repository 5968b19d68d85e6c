"""Bridge and open-sky sections from the light in the upper camera."""

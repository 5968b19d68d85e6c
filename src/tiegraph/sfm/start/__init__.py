"""A model started from poses that are roughly known, instead of mapped from nothing."""

"""A ladder of real surveys at the size they were taken in, from public repositories, set by set (README.md)."""

"""Key points, COLMAP's database, matching and verification of exactly the listed pairs."""

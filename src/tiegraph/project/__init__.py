"""The run folder: settings, receipts, resume, the pool, progress. Knows no photogrammetry."""

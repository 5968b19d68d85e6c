"""One self-contained HTML report from receipts and artefacts, and the comparison of two runs."""

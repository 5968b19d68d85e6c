"""Design: which of the candidate pairs are matched at full resolution, by the accuracy they are expected to give."""

"""Page one, for the client: what, where, when, how good, whether that is good enough, what is handed over, and the
three worst problems; on one sheet of paper, with a line to sign."""

"""Retrieval of look-alikes: visual words learnt on the survey itself, loose photographs, copies."""

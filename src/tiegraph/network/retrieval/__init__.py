"""Which images look alike: words learnt on the set itself, loose photographs, copies."""

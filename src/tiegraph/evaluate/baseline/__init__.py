"""Before and after, honestly: another method on a block of the same survey, and what it costs at equal registration.

A method that registers fewer images is quicker for that reason alone (paper 000: 222 of 500 images, 001: 937 of 4020),
and one that registers all of them at wrong places is worth nothing. So both methods are run by themselves on the same
images, a cost is that of an image registered, and a speed-up is never stated without the images that one of them lost.
``block`` says which images, ``equal`` what is stated.
"""

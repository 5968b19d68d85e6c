"""On site: images are followed while they are taken (paper 003: the acquisition confirmed on site).

``onsite`` hands out files once they are whole, places them in the survey's coarse model by their ties to images that
have a pose, and makes of poses and ties what ``page.html`` draws.

Of the engines that exist, measured on ``canal`` (640 x 480, six cameras, CPU of one core): an image with its preview
and ten ties costs 0.12 s. Odometry follows frames one by one but needs a calibrated rig and small steps (``canal`` is
not followed); the coarse model needs neither but is made of all ties at once, 5 s of 60 images and 14 s of 200 even
where few tracks are taken. So the coarse model is made again and again in a process of its own (the second core), each
time of all that has arrived. In between new frames are resected: points are intersected from the images that have a
pose, and a frame takes its pose from them. An error of a resection lasts until the next model.
"""

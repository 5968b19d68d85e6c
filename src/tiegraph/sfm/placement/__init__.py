"""Registration repaired and completed: frames at the wrong place, images without one, before the final adjustment.

1. *Placement* (``repair_registration``). The pass must not jump (``continuity``; the coarse model tells how long a step
   is, else the pass itself), and the verified matches of a frame, also those that the mapper threw out, must agree with
   its pose (``verified``, ``consistency``). A frame or block that fails is resected from the ties of the others, by all
   cameras of its rig at once (``resection``, ``repair``), or left out with its reason. Segments of a pass that a jump
   separates never join into a block, whatever false ties connect them.
2. *Completeness*. Images that no mapper registered, or that lie in another model, are registered by all their
   verified matches with the first model (``register_missing``). Points are triangulated anew after either step. What is
   still missing is searched by *guided matching* (``guided_registration``, ``guided_matches``): the pose is predicted
   from the coarse model or from the neighbours in the pass (``predictedpose``), the key points are compared with the
   points of the model only near where these must be seen, and the image is registered if enough agree. An image that is
   held by the rig alone is tied in the same way. Each image still missing has its reason.
"""

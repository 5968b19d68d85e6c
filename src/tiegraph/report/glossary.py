"""The words of the report, for those who meet them first here."""

from tiegraph.report.texts import t

_WORDS = {
    "accuracy in the world": "how far a point may be from its true coordinates; what holds the survey there is named",
    "accuracy in shape": "how far parts may be off each other, wherever the survey as a whole stands",
    "accuracy of a point": "how far a point may be off its neighbours: the noise of a surface",
    "predicted": "one standard deviation, by the run's own account: about two thirds of the errors are smaller",
    "measured": "root mean square of the differences from what the run did not know, or had held back",
    "sigma": "standard deviation",
    "camera": "one lens with its sensor",
    "rig": "cameras that are mounted together and fire together",
    "frame": "the images that a rig takes at one instant",
    "pass": "a sequence of frames along one path",
    "section": "a part of the survey under a bridge or under open sky",
    "registered": "an image whose place and direction are borne out by points that it sees",
    "placed by the rig": "an image whose place follows from the other cameras of its rig, without points of its own",
    "tie": "two images in which the same points were found and verified",
    "weak link": "a tie whose loss would part the survey",
    "candidate": "two images that may see the same surface",
    "mask": "the part of an image that is not used: sky, water, the vehicle, what moves",
    "prior pose": "position or direction known before the images were used: GNSS, EXIF, odometry",
    "sparse model": "camera positions and the points that tie the images",
    "reprojection error": "how far a point falls from where it was seen in an image, in pixels",
    "georeferencing": "placing the model in coordinates of the Earth",
    "lever arm": "vector from the camera to the antenna, or between two cameras",
    "check point": "a surveyed point that the adjustment did not use: it measures",
    "control point": "a surveyed point that the adjustment used: it holds",
    "held-out position": "a given position that a fit did not use and is then compared with",
    "dense cloud": "points of the surface from every pixel that several images agree on",
    "pixel on the surface": "ground sampling distance: size of one pixel at the distance of the surface",
    "error ellipse": "where a point lies with 39 % probability by its standard deviations east and north",
    "M3C2": "distance of two clouds along the normal of the surface",
    "completeness": "share of the reference's points that have a point of the cloud nearby",
    "F-score": "mean (harmonic) of accuracy and completeness at a distance",
    "CRS": "coordinate reference system: what the coordinates count from",
}


def words() -> list[tuple[str, str]]:
    """(word, meaning) in English."""
    return list(_WORDS.items())


def glossary() -> list[tuple[str, str]]:
    """(word, meaning) in the language of the page."""
    return [(t(word), t(meaning)) for word, meaning in words()]

"""The preview model of the survey and the surface its images share."""

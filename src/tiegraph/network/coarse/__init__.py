"""The coarse model of the survey, made of previews, and the surface its images share."""

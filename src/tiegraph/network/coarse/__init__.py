"""The coarse model of the survey, made of previews, and the surface that its images share."""

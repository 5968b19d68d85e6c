"""Figures of merit: trajectories, clouds, back-projection (paper 000)."""

from tiegraph.evaluate.backprojection import backprojection_rmse
from tiegraph.evaluate.cloud import cloud_to_cloud
from tiegraph.evaluate.survey import evaluate_survey
from tiegraph.evaluate.trajectory import evaluate_trajectory

__all__ = ["backprojection_rmse", "cloud_to_cloud", "evaluate_survey", "evaluate_trajectory"]

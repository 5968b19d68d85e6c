"""How well any point of the world is known: the covariance of the placement, carried to points."""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry.transforms import motions

SIGMAS = ("position_m", "height_m", "yaw_deg", "tilt_deg", "scale")
_OF = ("tilt_deg", "tilt_deg", "yaw_deg", "position_m", "position_m", "height_m", "scale")


@dataclass(frozen=True)
class PlacementError:
    """Covariance (7, 7) of turn (rad, about east, north, up), shift (m) and log scale, all about ``middle`` (3,)."""

    middle: np.ndarray
    covariance: np.ndarray

    def sigma(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) sigmas of places in the world (N, 3), east, north, up, metres: what the placement leaves uncertain.

        The model's own errors (of poses, of the dense matching) come on top.
        """
        jacobian = self._jacobian(points)
        variance = np.einsum("nij,jk,nik->ni", jacobian, self.covariance, jacobian)
        return np.sqrt(np.clip(variance, 0, None))

    def covariances(self, points: np.ndarray) -> np.ndarray:
        """(N, 3, 3) covariances of places in the world (N, 3), east, north, up, square metres."""
        jacobian = self._jacobian(points)
        return np.einsum("nij,jk,nlk->nil", jacobian, self.covariance, jacobian)

    def _jacobian(self, points: np.ndarray) -> np.ndarray:
        """(N, 3, 7): how places (N, 3) move with turn, shift and log scale."""
        return motions(np.asarray(points, float).reshape(-1, 3) - self.middle)

    def sigmas(self) -> dict[str, float]:
        """position_m, height_m, yaw_deg, tilt_deg, scale."""
        sd = np.sqrt(np.clip(np.diag(self.covariance), 0, None))
        named = (np.hypot(sd[3], sd[4]), sd[5], np.degrees(sd[2]), np.degrees(np.hypot(sd[0], sd[1])), sd[6])
        return {n: round(float(v), 6) for n, v in zip(SIGMAS, named)}

    def widened_to(self, sigma: dict[str, float]) -> "PlacementError":
        """The same with sigmas at least those of ``sigma`` (position_m, ...), correlations kept."""
        factor = {n: max(1.0, sigma[n] / max(own, 1e-9)) for n, own in self.sigmas().items()}
        each = np.array([factor[n] for n in _OF])
        return PlacementError(self.middle, self.covariance * each[:, None] * each)

    def to_dict(self) -> dict:
        """JSON-ready."""
        return {"middle": self.middle.tolist(), "covariance": self.covariance.tolist()}

    @staticmethod
    def from_dict(data: dict) -> "PlacementError":
        """Inverse of ``to_dict``."""
        return PlacementError(np.array(data["middle"], float), np.array(data["covariance"], float))

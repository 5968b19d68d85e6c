"""How well any point of the world is known: the covariance of the placement, carried to points."""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry.transforms import motions


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

    def widened_to(self, sigma: dict[str, float]) -> "PlacementError":
        """The same with sigmas at least those of ``sigma`` (position_m, height_m, yaw_deg, tilt_deg, scale)."""
        return PlacementError(self.middle, widened(self.covariance, sigma))

    def to_dict(self) -> dict:
        """JSON-ready."""
        return {"middle": self.middle.tolist(), "covariance": self.covariance.tolist()}

    @staticmethod
    def from_dict(data: dict) -> "PlacementError":
        """Inverse of ``to_dict``."""
        return PlacementError(np.array(data["middle"], float), np.array(data["covariance"], float))


def widened(covariance: np.ndarray, wanted: dict[str, float]) -> np.ndarray:
    """A covariance (7, 7) scaled so that its sigmas are those of the placement, correlations kept.

    ``wanted``: position_m, height_m, yaw_deg, tilt_deg, scale, as the jackknife gives them.
    """
    sd = np.sqrt(np.clip(np.diag(covariance), 1e-18, None))
    formal = {
        "tilt_deg": np.degrees(np.hypot(sd[0], sd[1])), "yaw_deg": np.degrees(sd[2]),
        "position_m": np.hypot(sd[3], sd[4]), "height_m": sd[5], "scale": sd[6],
    }  # fmt: skip
    ratio = {n: max(1.0, wanted[n] / formal[n]) for n in formal}
    names = ("tilt_deg", "tilt_deg", "yaw_deg", "position_m", "position_m", "height_m", "scale")
    factor = np.array([ratio[n] for n in names])
    return covariance * factor[:, None] * factor[None, :]

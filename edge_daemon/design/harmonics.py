"""Semi-analytical finite elements: a section's mesh times Fourier harmonics around the axis.

Displacements of the family that is symmetric about the major axis are u_r cos(n t), u_t sin(n t), u_z cos(n t); torque
is u_t of harmonic 0. The stiffness is K0 + n K1 + n^2 K2 (Zienkiewicz & Taylor, The Finite Element Method vol. 2, 2000,
chapter 9), so that three matrices serve all harmonics. Strains and stresses come in the order rr, tt, zz, rz, rt, tz.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from edge_daemon.design.drawing import DesignError
from edge_daemon.design.mesh import Meridian
from edge_daemon.records import Array

MISSING = "this command needs scikit-fem: pip install edge-daemon[design]"


def scikit_fem() -> Any:
    """The library of elements, or one clear line."""
    try:
        import skfem
    except ImportError as error:
        raise DesignError(MISSING) from error
    return skfem


@dataclass(frozen=True, slots=True)
class Elastic:
    """A solid, isotropic or not: (6, 6) stiffness [Pa] of each element, density [kg/m^3]."""

    stiffness_Pa: Array
    density_kg_m3: float


def isotropic(youngs_Pa: float, poisson: float) -> Array:
    """(6, 6) [Pa]."""
    shear = youngs_Pa / (2.0 * (1.0 + poisson))
    lame = youngs_Pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    matrix = np.diag([2 * shear] * 3 + [shear] * 3)
    matrix[:3, :3] += lame
    return matrix


def orthotropic(youngs_Pa: float, poisson: float, axial: float) -> Array:
    """(6, 6) [Pa] of a ring whose teeth run along the axis: `axial` times as stiff that way."""
    shear = youngs_Pa / (2.0 * (1.0 + poisson))
    compliance = np.diag([1 / youngs_Pa, 1 / youngs_Pa, 1 / (axial * youngs_Pa), *([1 / shear] * 3)])
    for i, j in ((0, 1), (0, 2), (1, 2)):
        compliance[i, j] = compliance[j, i] = -poisson / youngs_Pa / (axial if 2 in (i, j) else 1.0)
    return np.asarray(np.linalg.inv(compliance))


class Rings:
    """A section's matrices, ready for any harmonic."""

    def __init__(self, mesh: Meridian, elastic: Elastic) -> None:
        self.mesh, self.elastic = mesh, elastic
        self.nodes = mesh.nodes
        self.elements = mesh.elements
        self.size = 3 * len(self.nodes)
        self._dofs = (3 * self.elements.T[:, :, None] + np.arange(3)).reshape(-1, 27)
        basis = self._basis()
        plain, turning, weights, self._values = basis
        self.volume_m3 = float(2.0 * np.pi * weights.sum())
        self._weights = weights
        stress = np.einsum("eij,eqjk->eqik", elastic.stiffness_Pa, plain)
        turned = np.einsum("eij,eqjk->eqik", elastic.stiffness_Pa, turning)
        cross = _gram(plain, turned, weights)
        self._band = self._bands(
            [_gram(plain, stress, weights), cross + cross.transpose(0, 2, 1), _gram(turning, turned, weights)]
        )
        self._at_nodes = self._basis(at_nodes=True)[:2]
        self._shares = np.bincount(self.elements.ravel(), minlength=len(self.nodes))
        self._factors: dict[int, Any] = {}

    def _basis(self, at_nodes: bool = False) -> tuple[Array, Array, Array, Array]:
        """Strain operators (elements, points, 6, 27) of cos and of n sin parts, weights r dA, values (points, 9)."""
        fem = scikit_fem()
        reference = fem.ElementQuad2()
        corners = np.unique(self.elements[:4])
        flat = fem.MeshQuad(self.nodes[corners].T.copy(), np.searchsorted(corners, self.elements[:4]), sort_t=False)
        curved = fem.MeshQuad2.from_mesh(flat)
        places = curved.doflocs.copy()
        places[:, curved.dofs.element_dofs] = self.nodes.T[:, self.elements]
        curved = type(curved)(places, curved.t, sort_t=False)
        own = (np.asarray(reference.doflocs).T, np.ones(9)) if at_nodes else None
        basis = fem.Basis(curved, reference, quadrature=own) if own else fem.Basis(curved, reference, intorder=5)
        value = np.stack([np.asarray(part[0]) for part in basis.basis])
        slope = np.stack([np.asarray(part[0].grad) for part in basis.basis])
        radius = np.asarray(basis.global_coordinates())[0]
        plain, turning = _strains(value, slope, radius)
        return plain, turning, radius * basis.dx, value.transpose(1, 2, 0)

    def _bands(self, matrices: list[Array]) -> list[Array]:
        """Element matrices summed into lower bands, (1 + width, size)."""
        rows = np.repeat(self._dofs, 27, axis=1).ravel()
        columns = np.tile(self._dofs, (1, 27)).ravel()
        low = rows >= columns
        width = int((rows - columns).max())
        places = (rows - columns)[low] * self.size + columns[low]
        shape = (width + 1, self.size)
        return [
            np.bincount(places, np.ravel(matrix)[low], minlength=shape[0] * shape[1]).reshape(shape).astype(float)
            for matrix in matrices
        ]

    def held(self, harmonic: int) -> Array:
        """Degrees of freedom that are held: the clamp, or of a pancake its plane of symmetry."""
        last = 3 * self.mesh.numbers[-1]
        if not self.mesh.mirrored:
            return np.concatenate([last, last + 1, last + 2])
        return np.concatenate([last + 2, last + 1]) if harmonic == 0 else last + 2

    def band(self, harmonic: int) -> Array:
        """Lower band of the stiffness [N/m]; what is held has ones on its diagonal."""
        matrix = self._band[0] + harmonic * self._band[1] + harmonic**2 * self._band[2]
        held = self.held(harmonic)
        matrix[:, held] = 0.0
        for offset in range(1, matrix.shape[0]):
            matrix[offset, (held - offset)[held >= offset]] = 0.0
        matrix[0, held] = 1.0
        return matrix

    def solve(self, harmonic: int, forces: Array) -> Array:
        """Displacements [m] for nodal forces per radian's share [N], both (3 nodes, k)."""
        if harmonic not in self._factors:
            self._factors[harmonic] = cholesky_banded(self.band(harmonic), lower=True, check_finite=False)
        forces = forces.copy()
        forces[self.held(harmonic)] = 0.0
        return np.asarray(cho_solve_banded((self._factors[harmonic], True), forces, check_finite=False))

    def stresses(self, harmonic: int, displacement: Array) -> Array:
        """Amplitudes at the nodes [Pa], (nodes, 6), averaged over the elements that meet there."""
        plain, turning = self._at_nodes
        local = displacement[self._dofs]
        strain = np.einsum("eqij,ej->eqi", plain + harmonic * turning, local)
        stress = np.einsum("eij,eqj->eqi", self.elastic.stiffness_Pa, strain)
        places = self.elements.T.ravel()
        sums = [np.bincount(places, stress[:, :, k].ravel(), minlength=len(self.nodes)) for k in range(6)]
        return np.asarray(np.stack(sums, axis=1) / self._shares[:, None])

    def mass_band(self) -> Array:
        """Lower band of the mass [kg]."""
        one = np.einsum("eqa,eqb,eq->eab", self._values, self._values, self._weights)
        whole = np.zeros((len(one), 9, 3, 9, 3))
        for k in range(3):
            whole[:, :, k, :, k] = one
        return self._bands([self.elastic.density_kg_m3 * whole.reshape(-1, 27, 27)])[0]


def _gram(left: Array, right: Array, weights: Array) -> Array:
    """Sum over points of left^T right, (elements, 27, 27)."""
    return np.asarray(np.matmul(left.transpose(0, 1, 3, 2), right * weights[:, :, None, None]).sum(axis=1))


def _strains(value: Array, slope: Array, radius: Array) -> tuple[Array, Array]:
    """From shape functions (9, elements, points) and slopes (9, 2, elements, points)."""
    count, points = radius.shape
    plain, turning = (np.zeros((count, points, 6, 27)) for _ in range(2))
    dr, dz = (slope[:, k].transpose(1, 2, 0) for k in (0, 1))
    over_r = value.transpose(1, 2, 0) / radius[:, :, None]
    u, v, w = (slice(k, 27, 3) for k in range(3))
    plain[:, :, 0, u] = dr
    plain[:, :, 1, u] = over_r
    plain[:, :, 2, w] = dz
    plain[:, :, 3, u], plain[:, :, 3, w] = dz, dr
    plain[:, :, 4, v] = dr - over_r
    plain[:, :, 5, v] = dz
    turning[:, :, 1, v] = over_r
    turning[:, :, 4, u] = -over_r
    turning[:, :, 5, w] = -over_r
    return plain, turning

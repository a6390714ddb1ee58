"""Convergence of frequencies: quadratic tetrahedra, refinement, and the correction, against beams."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.convergence import (
    frequencies,
    quadratic_modes,
    refine,
    stiffness_correction,
)
from defplan_mj.body.elasticity import linear_modes
from defplan_mj.body.model import Material
from defplan_mj.body.tetmesh import lumped_mass, volumes
from tests.samples.meshes import bar

CORK = Material(density=1000.0, youngs_modulus=1e6, poissons_ratio=0.0)
SIDE = 0.05
# free-free bending of a beam 1 m long (Euler, Bernoulli), Hz; without shear and rotation of the sections
BEAM = np.array([4.730041, 7.853205]) ** 2 * np.sqrt(1e6 * SIDE**2 / 12 / 1000.0) / (2 * np.pi)


def test_a_refined_mesh_has_the_same_body_in_eight_times_the_tetrahedra():
    mesh = bar((3, 2, 1), (1.0, 0.4, 0.3))
    fine = refine(mesh)
    size = volumes(fine.vertices, fine.tetrahedra)
    assert len(size) == 8 * len(mesh.tetrahedra) and size.min() > 0.0
    assert size.sum() == pytest.approx(0.12)
    np.testing.assert_array_equal(fine.vertices[: len(mesh.vertices)], mesh.vertices)
    assert len(np.unique(fine.vertices.round(9), axis=0)) == len(fine.vertices)


def test_quadratic_tetrahedra_have_the_beam_s_frequencies_with_one_cell_across():
    squares, modes = quadratic_modes(bar((20, 1, 1), (1.0, SIDE, SIDE)), CORK, 4)
    found = np.sqrt(squares) / (2 * np.pi)
    np.testing.assert_allclose(found, np.repeat(BEAM, 2), rtol=0.03)
    np.testing.assert_allclose(found[:2], BEAM[0], rtol=0.01)
    assert modes.shape[1:] == (3, 4)


def test_quadratic_modes_are_mass_orthonormal_and_a_stretched_bar_weighs_what_it_does():
    mesh = bar((8, 1, 1), (1.0, 0.3, 0.3))
    squares, _ = quadratic_modes(mesh, CORK, 12)
    rod = np.sqrt(1e6 / 1000.0) / 2.0  # Hz, half a wave on 1 m
    found = np.sqrt(squares) / (2 * np.pi)
    assert np.abs(found / rod - 1.0).min() < 0.005


def test_refinement_comes_nearer_to_the_quadratic_frequencies():
    table = frequencies(bar((20, 1, 1), (1.0, SIDE, SIDE)), CORK, refinements=2, count=1)
    linear, converged = [row.hertz[0] for row in table[:-1]], table[-1].hertz[0]
    errors = np.array(linear) / converged - 1.0
    assert errors[0] > 0.2 and (np.diff(errors) < 0.0).all() and errors[-1] > 0.0
    # of second order in the end: 2.9 here
    assert 2.5 < errors[0] / errors[1] < 5.0 and 2.5 < errors[1] / errors[2] < 5.0
    assert [row.nodes for row in table] == [84, 369, 2025, 369]


def test_the_corrected_stiffness_has_the_frequencies_of_the_body():
    mesh = bar((24, 3, 2), (1.0, 0.12, 0.08))
    mass = lumped_mass(mesh.vertices, mesh.tetrahedra, CORK.density)
    squares, modes = linear_modes(mesh, CORK, mass, 5)
    correction = stiffness_correction(mesh, CORK, mass, modes, squares, 5)
    fine = frequencies(refine(mesh), CORK, refinements=0, count=5)
    converged = np.sort(correction.converged)
    np.testing.assert_allclose(converged, fine[-1].hertz, rtol=0.01)
    corrected = np.sqrt(squares * correction.modal) / (2 * np.pi)
    np.testing.assert_allclose(corrected, correction.converged, rtol=1e-9)
    left = np.sqrt(squares * correction.young) / (2 * np.pi) / correction.converged - 1.0
    np.testing.assert_allclose(left, correction.remaining, atol=1e-12)


def test_numbers_that_cannot_be_are_refused():
    with pytest.raises(DefplanError, match="at least 1 and 0"):
        frequencies(bar((2, 1, 1), (1.0, 0.1, 0.1)), CORK, refinements=-1)

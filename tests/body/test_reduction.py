"""The second reduction: what it can represent it represents, and it says how well it does."""

from __future__ import annotations

import numpy as np
import pytest

from defplan_mj.body.reduction import choose_tetrahedra, fit_weights, pod_basis, sample_shapes


def test_samples_stay_within_the_amplitude_and_reach_it():
    amplitude = np.array([1.0, 2.0, 0.5])
    q = sample_shapes(500, amplitude, np.random.default_rng(0))
    share = np.abs(q) / amplitude
    assert share.max() <= 1.0 and (share.max(0) > 0.95).all()
    assert np.linalg.norm(q / amplitude, axis=1).max() <= 1.5 + 1e-12
    assert share.max(1).min() < 0.2


def test_basis_spans_shapes_of_low_rank_exactly():
    rng = np.random.default_rng(1)
    mass = rng.uniform(0.5, 2.0, 30)
    shapes = np.einsum("ma,ani->mni", rng.normal(size=(40, 4)), rng.normal(size=(4, 30, 3)))
    basis, z = pod_basis(shapes, mass, 4)
    gram = np.einsum("n,nia,nib->ab", mass, basis, basis)
    np.testing.assert_allclose(gram, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(np.einsum("nik,mk->mni", basis, z), shapes, atol=1e-10)


def test_pursuit_finds_the_blocks_that_made_the_targets():
    rng = np.random.default_rng(2)
    features = rng.normal(size=(25, 300, 9))
    truth = [3, 11, 19]
    columns = np.concatenate([features[i] for i in truth], axis=1)
    weights = rng.normal(size=(5, 27))
    targets = columns @ weights.T
    assert sorted(choose_tetrahedra(features, targets, 3)) == truth
    np.testing.assert_allclose(fit_weights(columns, targets), weights, atol=1e-6)


@pytest.mark.parametrize("ridge", [1e-9, 1e-3])
def test_weights_solve_the_ridge_problem(ridge):
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(50, 6)), rng.normal(size=(50, 2))
    fitted = fit_weights(x, y, ridge)
    # the same as ordinary least squares with rows sqrt(r) I added
    extra = np.sqrt(ridge * np.trace(x.T @ x) / 6) * np.eye(6)
    expected = np.linalg.lstsq(np.vstack([x, extra]), np.vstack([y, np.zeros((6, 2))]), rcond=None)
    np.testing.assert_allclose(fitted, expected[0].T, atol=1e-9)

"""The cases of the operator fail where the operator is wrong."""

import numpy as np

from simgen.verification.validate import operator
from simgen.verification.validate.case import Context


def test_the_case_notices_a_tangent_that_is_none(monkeypatch):
    right = operator.tangent_action
    monkeypatch.setattr(operator, "tangent_action", lambda body, x, v: right(body, x, v) * (1.0 + 3e-6))
    rows = {row.quantity: row for row in operator.tangent(Context("cpu", None, None, None)).rows}
    assert not rows["elasticity: least relative error of central differences"].passed
    assert rows["contact: least relative error of central differences"].passed


def test_rotation_turns_about_its_axis():
    axis = np.array([1.0, 2.0, -0.5])
    Q = operator.rotation(axis, 2.4)
    np.testing.assert_allclose(Q @ Q.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(Q @ axis, axis, atol=1e-15)
    np.testing.assert_allclose(np.trace(Q), 1.0 + 2.0 * np.cos(2.4), rtol=1e-14)

"""The words of the reference of job files that are said where a constant is used; the page: test_reference_page.py."""

from job_reference import contact_meanings, solver_meanings

from simgen.config.job_schema import Solver, Trajectories


def test_every_constant_of_the_solver_and_of_the_contacts_is_explained():
    assert set(solver_meanings()) == set(Solver.model_fields) - {"element"}
    own = {"count", "max_force_n", "path", "too_thin"}
    assert set(contact_meanings()) == set(Trajectories.model_fields) - own

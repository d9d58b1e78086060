"""Settings name their terms and their changed tolerance."""

from simgen.verification.bench import settings


def test_settings_name_the_terms_and_the_tolerance_that_differ():
    tolerance = settings.layer_settings(settings.DEFAULT, settings.FRICTIONAL)[-1]
    assert tolerance.changed == "linear_tolerance 0.001"
    assert tolerance.terms == "elasticity + contact + friction"
    assert settings.Setting(settings.FRICTIONLESS, 1.0).changed == ""
    assert settings.Setting(settings.BIOTAC, 1.0, core=True).terms == "elasticity + contact + friction + core contact"

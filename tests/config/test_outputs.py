"""The table of outputs: names, shapes, and what a dataset keeps."""

from simgen.config.outputs import OPTIONAL, OUTPUTS, PIXEL_COLUMN, PIXEL_ROW, SURFACE_VERTEX, VERTEX, kept_outputs


def test_names_are_unique_and_types_can_hold_what_is_missing():
    names = [output.name for output in OUTPUTS]
    assert len(set(names)) == len(names)
    assert {output.dtype for output in OUTPUTS} == {"int8", "int16", "int32", "float32", "float64"}


def test_an_output_is_a_mesh_a_measurement_a_certificate_or_the_status():
    for output in OUTPUTS:
        kinds = [output.is_mesh, output.is_image, output.is_sensor_value, output.is_certificate]
        assert sum(kinds) + (output.name == "status") == 1, output.name


def test_shapes_have_the_sensor_s_numbers_of_vertices():
    lengths = {VERTEX: 7, SURFACE_VERTEX: 4, PIXEL_ROW: 20, PIXEL_COLUMN: 15}
    shapes = {output.name: output.shape_of(lengths) for output in OUTPUTS}
    assert shapes["displacement"] == (7, 3) and shapes["stress"] == (4, 6) and shapes["contact_area"] == ()
    assert shapes["height_map"] == (20, 15)


def test_a_dataset_keeps_what_its_job_needs():
    plain, everything = ({each.name for each in kept_outputs(*asked)} for asked in
                         ((False, False), (True, True, OPTIONAL)))  # fmt: skip
    assert everything == {output.name for output in OUTPUTS}
    assert everything - plain == {*OPTIONAL, "cavity_pressure", "certificate/liquid_volume_error"}
    legs = {each.name for each in kept_outputs(fluid=False, legs=True)}
    assert legs - plain == {"shear_force", "slip_share"}

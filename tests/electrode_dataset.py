"""A dataset of stand-ins with the output mesh of the BioTac, whose electrodes read something."""

from functools import cache

import fake
import numpy as np

from simgen.dataset.reader import Dataset
from simgen.pipeline.run import run
from simgen.sensors.sensor import load_sensor


@cache
def output_mesh():
    """The BioTac's, which takes a second to load."""
    return load_sensor("biotac").output_mesh


def presser(job, sensor, device):
    """As the fake one, but the BioTac's skin moves as a whole, by a tenth of the depth, towards the pose's +y."""

    def press(indenters, poses):
        results = fake.failing_presser(job, sensor, device)(indenters, poses)
        if sensor == "biotac":
            count = len(output_mesh().vertices)
            for pose, result in zip(poses, results, strict=True):
                move = 0.1 * job.indenter_path.depths_m[:, None, None] * pose[:3, 1]
                reached = (result.status == 0)[:, None, None]
                result.outputs["displacement"] = np.where(reached, move, np.nan) * np.ones((count, 1))
        return results

    return press


def make(path):
    """Four trajectories, three indenters, four depths of 0.1 to 0.4 mm; the ring stalls from the third depth on."""
    plan = fake.make_plan(fake.make_job())
    mesh = output_mesh()
    own = {"rest_positions": mesh.vertices, "tetrahedra": mesh.tetrahedra, "held": mesh.held,
           "surface_triangles": mesh.surface_triangles, "touchable": mesh.touchable}  # fmt: skip
    plan.arrays.update({f"biotac/{key}": values for key, values in own.items()})
    run(plan, path, build=presser)
    return Dataset(path)

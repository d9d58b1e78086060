"""Exchange of datasets with other programs: `exporting` writes their formats, `importing` reads them.

Formats: ``result_files``, HDF5 as ACROSS and biotac_sim lay it out; ``training_arrays``, memory-mapped numpy arrays;
``paraview``, time series of meshes.
"""

from simgen.dataset.exchange.result_files import ResultFile, Sample, is_result_file, write

__all__ = ["ResultFile", "Sample", "is_result_file", "write"]

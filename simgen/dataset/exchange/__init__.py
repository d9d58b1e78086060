"""Datasets in the formats of others: written (`exporting`) and read (`importing`).

``result_files`` are the HDF5 layouts of the ACROSS framework and of biotac_sim, ``training_arrays`` memory-mapped numpy
arrays, ``paraview`` time series of meshes.
"""

from simgen.dataset.exchange.result_files import ResultFile, Sample, is_result_file, write

__all__ = ["ResultFile", "Sample", "is_result_file", "write"]

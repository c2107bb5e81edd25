"""The netCDF files through xarray: times, finite fields, errors that agree with the scores."""

import csv
import pathlib
import sys

import numpy
import xarray


def main():
    directory = pathlib.Path(sys.argv[1])
    with (directory / "scores.csv").open() as file:
        rows = list(csv.DictReader(file))
    truth = xarray.open_dataset(directory / "truth.nc", engine="scipy")
    assert numpy.isfinite(truth.h).all() and str(truth.time.values[0])[:10] == "2026-01-15", truth
    methods = sorted({row["method"] for row in rows})
    for method in methods:
        own = xarray.open_dataset(directory / f"{method}.nc", engine="scipy")
        error = own.h_analysis.values - truth.h.sel(time=own.time).values
        found = numpy.sqrt((error**2).mean(axis=(1, 2)))
        written = [float(row["rmse_analysis h [m]"]) for row in rows if row["method"] == method]
        assert len(written) == len(found) and numpy.allclose(found, written, rtol=1e-9), method
    observations = xarray.open_dataset(directory / "observations.nc", engine="scipy")
    assert observations.sizes["obs"] > 1000, observations
    print(f"netCDF: {', '.join(methods)} agree with scores.csv")


main()

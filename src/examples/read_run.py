"""Every file of a run in xarray and pandas: `python read_run.py out/quickstart`."""

import json
import pathlib
import sys

import pandas as pd
import xarray as xr

run = pathlib.Path(sys.argv[1])

# summary.json: scores of the whole run, with units, kinds and settings.
summary = json.loads((run / "summary.json").read_text())
assert summary["layout_version"] == 1
rows = [
    {"method": name, "kind": own["kind"], "variable": variable, "rmse": value}
    for name, own in summary["methods"].items()
    for variable, value in own.get("rmse_analysis", {}).items()
]
table = pd.DataFrame(rows).pivot(index="method", columns="variable", values="rmse")
units = {variable["name"]: variable["unit"] for variable in summary["variables"]}
print(f"{summary['title']}, {summary['begin']} to {summary['end']}, {summary['threads']} threads; RMSE in {units}")
print(table.round(3))

# scores.csv: the scores of every cycle.
scores = pd.read_csv(run / "scores.csv", parse_dates=["valid_time"])
counting = scores[scores.cycle >= summary["scored_from_cycle"]]
first = summary["variables"][0]
column = f"rmse_analysis {first['name']} [{first['unit']}]"
over_cycles = counting.groupby("method")[column].apply(lambda errors: (errors**2).mean() ** 0.5)
for name, value in over_cycles.items():
    assert abs(value / summary["methods"][name]["rmse_analysis"][first["name"]] - 1) < 1e-9, name

# scores_long.csv: the same, a row for each value.
long = pd.read_csv(run / "scores_long.csv", parse_dates=["valid_time"])
chosen = long[(long.score == "rmse_analysis") & (long.variable == first["name"])]
by_method = chosen.pivot(index="valid_time", columns="method", values="value")
assert (by_method[scores.method[0]].dropna().values == scores[scores.method == scores.method[0]][column].dropna().values).all()
print(f"scores_long.csv: {len(long)} values of {long.score.nunique()} scores")

# truth.nc and METHOD.nc: fields and biases over time.
truth = xr.open_dataset(run / "truth.nc")
for name in summary["methods"]:
    method = xr.open_dataset(run / f"{name}.nc")
    error = method[f"{first['name']}_analysis"] - truth[first["name"]]
    print(f"{name}: largest error of {first['name']} at the end {float(abs(error.isel(time=-1)).max()):.2f}")

# observations.nc: every observation, with its departures from each method.
observations = xr.open_dataset(run / "observations.nc")
print("observations.nc:", ", ".join(sorted(observations.data_vars)))

# Files that only some runs have.
for name in ["parameters.csv", "forecasts.csv", "readings.csv"]:
    if (run / name).exists():
        print(f"{name}: {len(pd.read_csv(run / name))} rows")
names = (run / "files.txt").read_text().splitlines()
assert {"summary.json", "scores.csv", "truth.nc", "observations.nc"} <= {name.split()[-1] for name in names}, names

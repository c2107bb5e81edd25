#!/bin/sh
# A system that runs every day: each day's run goes on from the state in which the day before ended, reads the observations of
# the day, and takes what it has found out of the sensors into their database. `today` is what cron would call.
#
#   src/examples/daily.sh target/release/isobar [DAYS]
#
# Here the days pass one after the other, and the runs are killed at random moments and started again. In the end the state of
# all methods is, to the bit, that of one run over all days, and so are the scores.
set -eu
isobar=$(realpath "$1")
days=${2:-10}
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
cd "$place"

# The scenario of a day, or of several: its first day, from 0, and the number of its cycles.
scenario() {
    cat << END
title = "A tracer in a steady wind, day by day"
phenomenon = "Biases of groups of stations"
source = "src/examples/daily.sh"
seed = 1
start = "$(date -u -d "2026-01-15 00:00:00 UTC + $1 days" +%Y-%m-%dT%H:%M:%SZ)"
grid = { nx = 24, ny = 16, dx_km = 100, boundary = "periodic" }
model = { kind = "advection", time_step_s = 1800, wind = { kind = "uniform", u_m_per_s = 9, v_m_per_s = 4 }, scheme = "first_order_upwind" }
initial = { kind = "cosine_wave", amplitude = 1, waves_x = 2 }
background_error.components = [{ kind = "univariate", variable = "tracer", sigma = 0.5, length_km = 300 }]
model_error.components = [{ kind = "univariate", variable = "tracer", sigma = 0.15, length_km = 300 }]
cycle = { count = $2, window_hours = 6 }
sensors = { database = "sensors.db", writes = "fkf" }
forecast = { lead_hours = 18, every_hours = 6 }

[networks.stations]
kind = "radiosonde"
stations = { regular = [6, 4] }
groups = ["A", "B", "C"]
reference_groups = ["A"]
observe = { tracer = 0.2 }
bias = [{ per = "group", variable = "tracer", sigma = 0.3, evolution = { kind = "random_walk", sigma_per_sqrt_day = 0.1 } }]

[networks.ships]
kind = "file"
file = "ships.csv"
time_tolerance_minutes = 30

[methods]
var = { kind = "3dvar" }
fkf = { kind = "fkf", factors = 20, adapt = { model_error = true } }
kf = { kind = "kf", adapt = { observation_error = true } }
letkf = { kind = "letkf", members = 20, localization_radius_km = 600 }
END
}

# What ships have reported on some days, from the first to the last: at noon and at midnight.
ships() {
    echo "time,x_m,y_m,variable,value,sigma,id"
    for day in $(seq "$1" "$2"); do
        for hour in 12 24; do
            date -u -d "2026-01-15 00:00:00 UTC + $day days + $hour hours" \
                "+%Y-%m-%dT%H:%M:%SZ,$((500000 + 100000 * (day % 7))),700000,tracer,0.$((day % 4))5,0.3,Ship"
        done
    done
}

# Does what is left to be done of a day, in whatever state yesterday's call or the last attempt of today's has left it.
today() {
    if [ "$1" -gt 0 ]; then from="--from out/$(($1 - 1))/day"; else from=""; fi
    scenario "$1" 4 > day.toml
    ships "$1" "$1" > ships.csv
    # The order matters: what was begun is finished; what is complete is left alone; else the day begins.
    $kill "$isobar" resume "out/$1/day" --quiet > said 2>&1 || [ -e "out/$1/day/summary.json" ] ||
        $kill "$isobar" run day.toml $from --out "out/$1" --checkpoint-cycles 1 --no-report --no-rerun --quiet > said 2>&1
}

# How long a day takes, in milliseconds.
kill=""
began=$(date +%s%N)
today 0
length=$((($(date +%s%N) - began) / 1000000))

kills=0
resumed=0
for day in $(seq 1 $((days - 1))); do
    for attempt in 1 2 3; do
        # Some moments are early, before there is anything to be resumed; others late, when files get their names.
        kill="timeout -s KILL $(awk -v s="$day$attempt" -v ms="$length" 'BEGIN { srand(s); rand(); print rand() * ms / 1000 + 0.01 }')"
        if ls "out/$day/.day.partial/checkpoint-"* > /dev/null 2>&1; then resumed=$((resumed + 1)); fi
        today "$day" || kills=$((kills + 1))
    done
    kill=""
    today "$day" || { cat said; exit 1; }
done

# The same in one run.
mkdir whole
scenario 0 $((4 * days)) > whole/day.toml
ships 0 $((days - 1)) > whole/ships.csv
"$isobar" run whole/day.toml --out whole/out --no-report --no-rerun --quiet > /dev/null
cmp whole/out/day/final_state.bin "out/$((days - 1))/day/final_state.bin"
{ head -1 out/0/day/scores.csv; for day in $(seq 0 $((days - 1))); do tail -n +2 "out/$day/day/scores.csv"; done; } > scores.csv
cmp whole/out/day/scores.csv scores.csv
echo "$days days, $kills runs were killed, $resumed times one was resumed: the end is that of one run"

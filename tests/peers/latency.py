"""Reads the files of `mrroc jitter --out` with an independent HdrHistogram, and compares them with the report.

The report is a JSON object on standard input; the argument is the directory of the files.
"""

import json
import math
import sys
from pathlib import Path

from hdrh.histogram import HdrHistogram
from hdrh.log import HistogramLogReader

LONGEST = 10_000_000_000
QUANTILES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "max": 1.0}


def quantiles(bins, count):
    """Quantiles of the report, µs, from ascending pairs (value in µs, cumulative count)."""

    def at(quantile):
        wanted = max(1, math.ceil(quantile * count - 1e-9))
        return next(value for value, so_far in bins if so_far >= wanted)

    return {name: at(quantile) for name, quantile in QUANTILES.items()}


def close(found, expected, what):
    """Both values are the upper end of the same bin, rounded to three decimals of a µs."""
    assert abs(found - expected) <= 0.0006, f"{what}: {found} µs, and {expected} µs in the report"


def log(path, side):
    """Every interval can be decoded, the intervals are consecutive, and their sum is the report's distribution."""
    total = HdrHistogram(1, LONGEST, 3)
    reader = HistogramLogReader(str(path), total)
    intervals, last = 0, 0.0
    while interval := reader.get_next_interval_histogram():
        start, end = interval.get_start_time_stamp(), interval.get_end_time_stamp()
        assert 0 <= start <= end, (start, end)
        assert start >= last - 2, "intervals overlap"
        last = end
        total.add(interval)
        intervals += 1
    assert intervals > 0
    assert total.get_total_count() == side["cycles"], (total.get_total_count(), side)
    so_far, bins = 0, []
    for bin_ in total.get_recorded_iterator():
        so_far += bin_.count_added_in_this_iter_step
        bins.append((total.get_highest_equivalent_value(bin_.value_iterated_to) / 1e3, so_far))
    for name, value in quantiles(bins, so_far).items():
        close(value, side[name], f"{path.name} {name}")
    return total, intervals


def distribution(path, side):
    """Returns (value in µs, cumulative count) of each line, ascending to the report's maximum and count."""
    lines = path.read_text().splitlines()
    assert lines[0].split() == ["Value", "Percentile", "TotalCount", "1/(1-Percentile)"], lines[0]
    rows = [line.split() for line in lines[2:] if not line.startswith("#")]
    bins = [(float(row[0]), int(row[2])) for row in rows]
    assert bins == sorted(bins), path
    count = side["cycles"]
    assert bins[-1][1] == count, (bins[-1], side)
    close(bins[-1][0], side["max"], f"{path.name} max")
    for row, (_, so_far) in zip(rows, bins):
        assert so_far / count >= float(row[1]) - 1e-9, row
    summary = " ".join(line for line in lines if line.startswith("#["))
    numbers = [float(word.strip("],")) for word in summary.split() if word[0].isdigit()]
    assert len(numbers) == 6 and numbers[3] == count, summary
    close(numbers[2], side["max"], f"{path.name} summary")
    medians = [float(row[0]) for row in rows if float(row[1]) == 0.5]
    close(medians[0], side["p50"], f"{path.name} p50")
    return bins


def main():
    directory, report = Path(sys.argv[1]), json.load(sys.stdin)
    total, intervals = log(directory / "ours.hlog", report["ours"])
    for value, so_far in distribution(directory / "ours.hgrm", report["ours"]):
        index = total._counts_index_for(round(value * 1e3))
        counted = sum(total.get_count_at_index(i) for i in range(index + 1))
        assert counted == so_far, f"{value} µs: {counted}, and {so_far} in the distribution"
    distribution(directory / "peer.hgrm", report["peer"])
    print(f"{total.get_total_count()} cycles in {intervals} intervals agree")


main()

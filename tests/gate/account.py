"""Account of a run: time of the processors, other load of the host, and the table at the end."""
import os


def processors():
    """Busy and stolen time of all processors since the start of the host, s."""
    with open("/proc/stat", encoding="ascii") as stat:
        user, nice, system, _, _, interrupts, soft, stolen = map(int, stat.readline().split()[1:9])
    tick = os.sysconf("SC_CLK_TCK")
    return (user + nice + system + interrupts + soft) / tick, stolen / tick


def table(parts, durations, host, longest=30):
    """Lines of the table: each part with its times, then the longest tests."""
    width = max(len(part.name) for part in parts) + 2
    lines = ["", f"{'part':<{width}}{'wall s':>9}{'processor s':>13}"]
    sums = {}
    for kind in ("build", "test", "download"):
        chosen = [part for part in parts if part.kind == kind and part.outcome is not None]
        for part in chosen:
            if part.outcome == "passed" or part.outcome == "FAILED":
                note = "" if part.outcome == "passed" else "  FAILED"
                lines.append(f"{part.name:<{width}}{part.wall:>9.1f}{part.seconds:>13.1f}{note}")
            else:
                lines.append(f"{part.name:<{width}}  {part.outcome}")
        sums[kind] = sum(part.seconds for part in chosen)
    wall, busy, stolen, downloads = host["wall"], host["busy"], host["stolen"], host["downloads"]
    ours = sum(sums.values())
    lines += [
        f"{'all without downloads':<{width}}{wall - downloads:>9.1f}{sums['build'] + sums['test']:>13.1f}",
        f"builds {sums['build']:.0f} and tests {sums['test']:.0f} processor seconds; downloads alone {downloads:.0f} s",
        f"host: {os.cpu_count()} processors, {max(busy - ours, 0):.0f} processor seconds of other work, {stolen:.0f} s stolen, "
        f"load {os.getloadavg()[0]:.1f}",
    ]
    if durations:
        lines += ["", f"the {min(longest, len(durations))} longest of {len(durations)} tests, s"]
        lines += [f"{seconds:>8.1f}  {name}" for seconds, name in sorted(durations, reverse=True)[:longest]]
    return lines

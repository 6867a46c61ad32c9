//! The report of a run as one HTML file with its tables and plots. The page loads nothing: style and plots are in it.

use std::fmt::{Display, Write as _};

use servo::Timing;

use super::text::{lost_records, rounded};
use super::{BusReport, CycleState, Deviation, FaultReport, RunReport, Tracks, counted, counted_as, plots};
use crate::cell::printable;
use crate::charts::{ChartError, escaped};

const STYLE: &str = include_str!("page.css");

/// The page of a run. It is well-formed XML as well.
pub(crate) fn page(report: &RunReport, tracks: &Tracks, timing: &Timing) -> Result<String, ChartError> {
    let title = format!("{} {}", report.cell, report.outcome);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <title>{0}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{0}</h1>\n",
        text(&title)
    );
    let cycle = &report.cycle;
    paragraph(
        &mut page,
        format_args!(
            "Bench {}, {:.1} times real time. {} of {} µs, {} missed.",
            report.bench,
            report.realtime_factor,
            counted(cycle.cycles, "cycle"),
            cycle.period_us,
            cycle.missed
        ),
    );
    if report.lost_records > 0 {
        paragraph(
            &mut page,
            format_args!("{}: errors of robots and plots lack them.", lost_records(report.lost_records)),
        );
    }
    let figures: Vec<_> = report.figures.iter().map(|(name, value)| format!("{name}: {value:.4}")).collect();
    list(&mut page, "Devices", &report.devices);
    list(&mut page, "Figures of the task", &figures);
    list(&mut page, "Faults", &report.faults);
    list(&mut page, "Recovered errors", &report.recovered);
    report.faults.iter().chain(&report.recovered).for_each(|fault| last_cycles(&mut page, fault));
    list(&mut page, "Incomplete files", &report.incomplete_files);
    list(&mut page, "Motions slowed by joints", &report.slowed);
    if report.more_slowed > 0 {
        paragraph(
            &mut page,
            format_args!(
                "{}.",
                counted_as(report.more_slowed, "further motion was slowed", "further motions were slowed")
            ),
        );
    }
    list(&mut page, "Oscillations", &report.oscillations);
    list(&mut page, "Device configurations", &report.configurations);
    let flaws: Vec<_> = report.configurations.iter().flat_map(|configuration| configuration.warnings()).collect();
    list(&mut page, "Flaws of device configuration files", &flaws);
    list(&mut page, "Warnings", &report.warnings);
    if report.more_warnings > 0 {
        paragraph(&mut page, format_args!("{} of drives.", counted(report.more_warnings, "further report")));
    }
    list(&mut page, "Faults of the scenario that have not acted", &report.idle_faults);
    list(&mut page, "Denied by the host", &report.denied);
    robots(&mut page, report);
    for track in &tracks.robots {
        let drawn = plots::robot(track)?;
        if !drawn.is_empty() {
            let _ = writeln!(page, "<h2>{}</h2>", text(&track.name));
        }
        drawn.iter().for_each(|svg| figure(&mut page, svg));
    }
    let _ = writeln!(page, "<h2>Motors</h2>");
    table(
        &mut page,
        "Tracking error of the motor shaft while moving, and counter at the reference",
        ["axis", "rad rms", "rad peak", "counts rms", "counts peak", "homing, counts", "faults"],
        report.axis_rows("–"),
    );
    let _ = writeln!(page, "<h2>Timing</h2>");
    times(&mut page, report);
    plots::timing(timing)?.iter().for_each(|svg| figure(&mut page, svg));
    buses(&mut page, report);
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

/// A text from the cell, the host or a drive: nothing of it is markup.
fn text(said: &str) -> String {
    escaped(&printable(said))
}

fn paragraph(page: &mut String, said: impl Display) {
    let _ = writeln!(page, "<p>{}</p>", text(&said.to_string()));
}

fn list(page: &mut String, title: &str, items: &[impl Display]) {
    if items.is_empty() {
        return;
    }
    let _ = writeln!(page, "<h2>{title}</h2>\n<ul>");
    for item in items {
        let _ = writeln!(page, "<li>{}</li>", text(&item.to_string()));
    }
    page.push_str("</ul>\n");
}

/// A plot is part of the page: it needs no name space.
fn figure(page: &mut String, svg: &str) {
    let svg = svg.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1);
    let _ = writeln!(page, "<figure>\n{svg}</figure>");
}

fn table<const COLUMNS: usize>(
    page: &mut String,
    caption: &str,
    head: [&str; COLUMNS],
    rows: impl IntoIterator<Item = [String; COLUMNS]>,
) {
    let head = [("th", head.map(str::to_owned))];
    let rows = rows.into_iter().map(|cells| ("td", cells));
    let _ = writeln!(page, "<table>\n<caption>{}</caption>", text(caption));
    for (tag, cells) in head.into_iter().chain(rows) {
        let cells = cells.map(|cell| format!("<{tag}>{}</{tag}>", text(&cell)));
        let _ = writeln!(page, "<tr>{}</tr>", cells.concat());
    }
    page.push_str("</table>\n");
}

/// The axis of a fault in the last cycles, or all axes of a fault that concerns no single axis.
fn last_cycles(page: &mut String, fault: &FaultReport) {
    let Some(last) = &fault.last_cycles else {
        return;
    };
    let end = last.cycles.last().map_or(0.0, |cycle| cycle.time_s);
    let concerned = |(_, name): &(usize, &String)| fault.axis.as_ref().is_none_or(|axis| axis == *name);
    for (axis, name) in last.axes.iter().enumerate().filter(concerned) {
        let row = |cycle: &CycleState| {
            let shown = |values: &[f64]| values.get(axis).map_or("–".to_owned(), |value| format!("{value:.6}"));
            [
                cycle.cycle.to_string(),
                format!("{:.3}", 1e3 * (cycle.time_s - end)),
                shown(&cycle.commanded_rad),
                shown(&cycle.measured_rad),
                shown(&cycle.velocity_rad_per_s),
                shown(&cycle.torque_nm),
            ]
        };
        table(
            page,
            &format!("Last cycles of axis {name} up to the fault: {}", fault.what),
            ["cycle", "time, ms", "commanded, rad", "measured, rad", "velocity, rad/s", "torque, N·m"],
            last.cycles.iter().map(row),
        );
    }
}

fn robots(page: &mut String, report: &RunReport) {
    let errors = |error: Option<Deviation>| {
        error.map_or(["–".to_owned(), "–".to_owned()], |error| [error.rms, error.peak].map(rounded))
    };
    let row = |robot: &super::RobotReport| {
        let [position_rms, position_peak] = errors(robot.position_mm);
        let [angle_rms, angle_peak] = errors(robot.orientation_deg);
        [
            robot.name.clone(),
            robot.subject.name().to_owned(),
            position_rms,
            position_peak,
            angle_rms,
            angle_peak,
            robot.cycles.to_string(),
            robot.unsolved.to_string(),
        ]
    };
    table(
        page,
        "Distance from the commanded path, while the robot moved or stood with power and a reference",
        ["robot", "error of", "mm rms", "mm peak", "° rms", "° peak", "cycles", "no pose"],
        report.robots.iter().map(row),
    );
}

fn times(page: &mut String, report: &RunReport) {
    let cycle = &report.cycle;
    let rows = cycle.times().map(|(name, times)| {
        let [p50, p99, p999, max] = [times.p50, times.p99, times.p999, times.max].map(|time| format!("{time:.1}"));
        [name.to_owned(), p50, p99, p999, max]
    });
    table(page, "Servo cycle, µs", ["", "p50", "p99", "p99.9", "max"], rows);
    let (causes, limit) = cycle.late();
    if !causes.is_empty() {
        let caption = format!("Cycles more than {limit} µs late");
        let rows = causes.into_iter().map(|(cause, count)| [cause.to_owned(), count.to_string()]);
        table(page, &caption, ["cause", "cycles"], rows);
    }
}

fn buses(page: &mut String, report: &RunReport) {
    let row = |bus: &BusReport| {
        [
            bus.name.clone(),
            bus.frames.to_string(),
            format!("{:.1}", bus.load_percent),
            format!("{:.1}", bus.worst_case_percent),
            bus.dropped_setpoints.to_string(),
            bus.missed_answers.to_string(),
        ]
    };
    page.push_str("<h2>Buses</h2>\n");
    table(
        page,
        "Traffic of the host",
        [
            "bus",
            "frames or telegrams",
            "load, %",
            "worst case, % of the period",
            "set-points dropped",
            "answers missed",
        ],
        report.buses.iter().map(row),
    );
    for wire in &report.wire {
        // Lines of a table in columns.
        let lines: Vec<_> = wire.to_string().lines().map(text).collect();
        let _ = writeln!(page, "<pre>{}</pre>", lines.join("\n").trim_matches('\n'));
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use roxmltree::{Document, ParsingOptions};
    use servo::{AxisRecord, Record};

    use super::*;
    use crate::bench::BenchKind;
    use crate::cell::CellFile;
    use crate::report::LastCycles;
    use crate::tasks::{Cell, Outcome};

    #[test]
    fn texts_of_a_page_are_no_markup_and_it_is_well_formed() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../cells/irb6.toml");
        let file = CellFile::read(&path).unwrap();
        async fn nothing(cell: &mut Cell) -> Outcome {
            cell.robot("irb6")?.enable().await
        }
        let mut report = crate::run(&file, BenchKind::Lockstep, nothing).unwrap();
        let mut tracks = Tracks::new(&file, true);
        let mut record = Record { axes: 5, ..Record::default() };
        for (axis, home) in record.axis.iter_mut().zip(&*file.arms[0].robot().home()) {
            *axis = AxisRecord { expected: Some(*home), measured: *home, ..AxisRecord::default() };
        }
        tracks.observe(&record);
        let planted = "<script>a & b</script> \u{7}]]>\"'";
        report.cell = planted.into();
        report.robots[0].name = planted.into();
        report.axes[0].name = planted.into();
        report.buses[0].name = planted.into();
        report.wire[0].bus = planted.into();
        report.denied.push(planted.into());
        let cycle = CycleState {
            cycle: 7,
            time_s: 0.014,
            commanded_rad: vec![0.5],
            measured_rad: vec![0.25],
            velocity_rad_per_s: vec![0.125],
            torque_nm: vec![-1.0],
        };
        let last_cycles = Some(LastCycles { axes: vec![planted.into()], cycles: vec![cycle] });
        report.faults.push(FaultReport { last_cycles, ..FaultReport::of_run(planted) });
        report.lost_records = 3;
        assert!(report.to_string().contains("3 records of cycles were lost"));
        tracks.robots[0].name = planted.into();
        let page = page(&report, &tracks, &Timing::default()).unwrap();
        assert!(!page.contains("<script") && !page.contains('\u{7}'), "{page}");
        assert!(page.contains("<p>3 records of cycles were lost"), "{page}");
        let row =
            ["7", "0.000", "0.500000", "0.250000", "0.125000", "-1.000000"].map(|cell| format!("<td>{cell}</td>"));
        assert!(page.contains(&row.concat()), "{page}");
        let options = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
        let read = Document::parse_with_options(&page, options).unwrap();
        let shown = printable(planted);
        let texts = read.descendants().filter(|node| node.is_text());
        let planted = texts.filter(|node| node.text().is_some_and(|it| it.contains(&shown)));
        // Title and headings of page, robot and two plots, and the rows and items.
        assert!(planted.count() >= 11, "{page}");
        assert!(!page.contains("NaN") && !page.contains("inf"), "{page}");
    }
}

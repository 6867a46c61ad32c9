//! The report of a run as tables for a person.

use std::fmt;

use super::{BusReport, Deviation, Percentiles, RobotReport, RunReport, counted, counted_as};

/// `irb6  tool 0.12 mm rms, 0.45 mm peak; 0.01° rms, 0.05° peak`
impl fmt::Display for RobotReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let said = [(self.position_mm, " mm"), (self.orientation_deg, "°")].into_iter().filter_map(|(error, unit)| {
            let Deviation { rms, peak } = error?;
            let [rms, peak] = [rms, peak].map(rounded);
            Some(format!("{rms}{unit} rms, {peak}{unit} peak"))
        });
        let said: Vec<_> = said.collect();
        write!(f, "{}  {} ", self.name, self.subject.name())?;
        match said.is_empty() {
            true => write!(f, "error unknown: no cycle with power and a reference")?,
            false => write!(f, "{}", said.join("; "))?,
        }
        if self.unsolved > 0 {
            write!(f, "; no pose in {}", counted(self.unsolved, "cycle"))?;
        }
        Ok(())
    }
}

/// Text for lost records of cycles.
pub(super) fn lost_records(count: u64) -> String {
    counted_as(count, "record of cycles was lost", "records of cycles were lost")
}

/// An error in mm or degrees with the digits that matter: 12.35, 0.12, 0.045, 0.0007.
pub(super) fn rounded(error: f64) -> String {
    let digits = match error {
        0.0995.. => 2,
        0.00995.. => 3,
        _ => 4,
    };
    format!("{error:.digits$}")
}

impl fmt::Display for RunReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for robot in &self.robots {
            writeln!(f, "{robot}")?;
        }
        if self.lost_records > 0 {
            writeln!(f, "{}", lost_records(self.lost_records))?;
        }
        let names = self.axes.iter().map(|axis| axis.name.len()).max().unwrap_or(0).max(4);
        if !self.axes.is_empty() {
            writeln!(
                f,
                "\n{:names$}  {:>12} {:>12} {:>10} {:>10} {:>10} {:>7}",
                "axis", "rms rad", "peak rad", "rms cnt", "peak cnt", "homing cnt", "faults"
            )?;
        }
        for [name, rms, peak, rms_counts, peak_counts, offset, faults] in self.axis_rows("-") {
            writeln!(
                f,
                "{name:names$}  {rms:>12} {peak:>12} {rms_counts:>10} {peak_counts:>10} {offset:>10} {faults:>7}"
            )?;
        }
        let cycle = &self.cycle;
        let mut rows = cycle.times().peekable();
        if rows.peek().is_some() {
            writeln!(f, "\n{:9} {}", "cycle, µs", Percentiles::HEAD)?;
        }
        for (name, times) in rows {
            writeln!(f, "{name:9} {times}")?;
        }
        writeln!(f, "\n{} of {} µs, {} missed", counted(cycle.cycles, "cycle"), cycle.period_us, cycle.missed)?;
        if cycle.wait.spin_percent > 0.0 {
            writeln!(
                f,
                "hybrid wait: woken {:.0} µs early, prepared {:.0} µs early, {:.1} % of a core spent spinning",
                cycle.wait.margin_us, cycle.wait.preparation_us, cycle.wait.spin_percent
            )?;
        }
        let (causes, limit) = cycle.late();
        if !causes.is_empty() {
            let causes: Vec<_> = causes.iter().map(|(cause, count)| format!("{cause} {count}")).collect();
            writeln!(f, "more than {limit} µs late: {}", causes.join(", "))?;
            let worst = cycle.worst.iter().map(|worst| {
                let (late, time) = (worst.late_us, worst.time_s);
                format!("{late:.0} µs {} at {time:.3} s", worst.cause)
            });
            writeln!(f, "the worst: {}", worst.collect::<Vec<_>>().join(", "))?;
        }
        for bus in &self.buses {
            writeln!(f, "{bus}")?;
        }
        for wire in &self.wire {
            write!(f, "{wire}")?;
        }
        for configuration in &self.configurations {
            writeln!(f, "configuration: {configuration}")?;
        }
        for denied in &self.denied {
            writeln!(f, "denied: {denied}")?;
        }
        for slowed in &self.slowed {
            writeln!(f, "slowed: {slowed}")?;
        }
        if self.more_slowed > 0 {
            writeln!(f, "slowed: {}", counted(self.more_slowed, "further motion"))?;
        }
        for oscillation in &self.oscillations {
            writeln!(f, "warning: {oscillation}")?;
        }
        for warning in &self.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        if self.more_warnings > 0 {
            writeln!(f, "warning: {} of drives", counted(self.more_warnings, "further report"))?;
        }
        for idle in &self.idle_faults {
            writeln!(f, "warning: {idle}")?;
        }
        for device in &self.devices {
            writeln!(f, "{device}")?;
        }
        for (name, value) in &self.figures {
            writeln!(f, "{name}: {value:.4}")?;
        }
        for error in &self.recovered {
            writeln!(f, "recovered: {error}")?;
        }
        for fault in &self.faults {
            writeln!(f, "fault: {fault}")?;
        }
        for file in &self.incomplete_files {
            writeln!(f, "incomplete: {file}")?;
        }
        write!(f, "{} {}, {:.1} times real time", self.cell, self.outcome, self.realtime_factor)
    }
}

impl fmt::Display for BusReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let traffic = match self.lines {
            None => counted(self.frames, "frame"),
            Some(lines) => format!("{} on {}", counted(self.frames, "telegram"), counted(lines, "line")),
        };
        let (load, worst) = (self.load_percent, self.worst_case_percent);
        write!(f, "bus {}: {traffic}, load {load:.1} %, worst case {worst:.1} % of the period", self.name)?;
        if self.dropped_setpoints + self.missed_answers > 0 {
            let (dropped, missed) =
                (counted(self.dropped_setpoints, "set-point"), counted(self.missed_answers, "answer"));
            write!(f, ", {dropped} dropped, {missed} missed")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Subject;

    #[test]
    fn errors_of_a_bus_are_told_in_the_right_number() {
        let of = |errors, error_passive, bus_off| BusReport {
            name: "arm".into(),
            lines: None,
            frames: 0,
            load_percent: 0.0,
            worst_case_percent: 0.0,
            dropped_setpoints: 0,
            missed_answers: 0,
            errors,
            error_passive,
            bus_off,
        };
        let told = |bus: BusReport| bus.trouble().unwrap().to_string();
        assert!(told(of(1, 0, 1)).starts_with("bus arm: 1 error frame, error passive 0 times, bus off 1 time: check"));
        assert!(told(of(2, 1, 0)).starts_with("bus arm: 2 error frames, error passive 1 time, bus off 0 times: check"));
        assert!(of(0, 0, 0).trouble().is_none());
        let json = serde_json::to_value(of(1, 0, 1).trouble()).unwrap();
        assert_eq!((&json["bus"], &json["node"], &json["count"]), (&"arm".into(), &().into(), &1.into()), "{json}");
    }

    #[test]
    fn one_of_each_is_told_in_the_singular() {
        let one = BusReport {
            name: "arm".into(),
            lines: Some(1),
            frames: 1,
            load_percent: 0.0,
            worst_case_percent: 0.0,
            dropped_setpoints: 1,
            missed_answers: 1,
            errors: 0,
            error_passive: 0,
            bus_off: 0,
        };
        let told = "bus arm: 1 telegram on 1 line, load 0.0 %, worst case 0.0 % of the period, 1 set-point dropped, 1 answer \
                    missed";
        assert_eq!(one.to_string(), told);
        let warning = crate::report::WarningReport {
            bus: "arm".into(),
            axis: None,
            node: None,
            code: None,
            register: None,
            time_s: None,
            count: 2,
            what: "said".into(),
        };
        assert_eq!(warning.to_string(), "bus arm: said and 1 time more");
    }

    #[test]
    fn a_robot_has_one_line_with_its_errors_in_mm_and_degrees() {
        let error = |rms, peak| Some(Deviation { rms, peak });
        let tool = RobotReport {
            name: "irb6".into(),
            subject: Subject::Tool,
            cycles: 100,
            unsolved: 0,
            position_mm: error(0.12, 12.345),
            orientation_deg: error(0.01, 0.00068),
        };
        assert_eq!(tool.to_string(), "irb6  tool 0.12 mm rms, 12.35 mm peak; 0.010° rms, 0.0007° peak");
        let joint = RobotReport { subject: Subject::Joint, orientation_deg: None, unsolved: 3, ..tool };
        assert_eq!(joint.to_string(), "irb6  joint 0.12 mm rms, 12.35 mm peak; no pose in 3 cycles");
        let unknown = RobotReport { position_mm: None, unsolved: 0, ..joint };
        assert_eq!(unknown.to_string(), "irb6  joint error unknown: no cycle with power and a reference");
    }
}

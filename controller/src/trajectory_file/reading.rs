//! Reading of trajectory files, with the notes on what is left out.

use std::fmt;

use can::counted;
use servo::MAX_AXES;

use super::{
    Axes, Coordinates, JointConvention, MOST_POSES, MotionType, PoseRow, ROWS, SmoothPose, TrajectoryFile,
    TrajectoryFileError, TrajectoryFileProblem, check_row,
};

/// Word of the line that tells the convention of the joints.
pub(super) const JOINTS: &str = "joints";

/// Columns of a row of a teach-in file: the time, and the coordinates of eight axes.
const TEACH_IN: usize = 9;

/// Rows of a pose in the oldest files: velocities at start and end come before the others.
const OLDEST_ROWS: usize = 5;

/// A part of a file that was left out, or that a reader might expect to be used. Columns and lines are counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryNote {
    /// Rows behind the number of poses.
    SpareRows {
        /// The first of these lines.
        line: usize,
        /// Number of these lines.
        rows: usize,
        /// Number of poses in line 2.
        poses: usize,
    },
    /// Columns behind those of the robot.
    SpareColumns {
        /// Number of columns of the widest row.
        columns: usize,
        /// Number of columns that are used.
        used: usize,
    },
    /// The file has no line ABSOLUTE or RELATIVE.
    OlderFormat,
    /// The rows of the velocities at start and end of a pose.
    EndVelocities,
}

impl fmt::Display for TrajectoryNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SpareRows { line, rows, poses } => {
                let poses = counted(*poses, "pose");
                write!(f, "lines from {line} on ({rows}) are ignored: they are behind the {poses} of line 2")
            }
            Self::SpareColumns { columns, used } => {
                write!(f, "rows have up to {}: those behind column {used} are ignored", counted(*columns, "column"))
            }
            Self::OlderFormat => f.write_str(
                "neither ABSOLUTE nor RELATIVE: read as a file of the format before September 2010, with positions",
            ),
            Self::EndVelocities => {
                f.write_str("five rows per pose: rows 1 and 2, velocities at start and end, are ignored")
            }
        }
    }
}

/// A row before its columns are known. Numbers that cannot be read are NaN.
#[derive(Clone, Copy)]
struct RawRow {
    line: usize,
    columns: usize,
    values: Axes,
}

impl RawRow {
    fn of((text, line): (&str, usize)) -> Self {
        let words = || text.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty());
        let mut values = Axes::default();
        for (value, word) in values.iter_mut().zip(words()) {
            *value = word.parse().unwrap_or(f64::NAN);
        }
        Self { line, columns: words().count(), values }
    }

    fn refused(&self, problem: TrajectoryFileProblem) -> TrajectoryFileError {
        TrajectoryFileError { line: self.line, problem }
    }
}

/// Reads a file of any robot, or for one with this number of axes.
pub(super) fn read(
    text: &str,
    axes: Option<usize>,
) -> Result<(TrajectoryFile, Vec<TrajectoryNote>), TrajectoryFileError> {
    let end = text.lines().count() + 1;
    let lines = text.lines().zip(1..).map(|(line, number)| (line.trim(), number));
    let mut lines = lines.filter(|(line, _)| !line.is_empty()).peekable();
    let no_head = TrajectoryFileError { line: end, problem: TrajectoryFileProblem::NoHead };
    let mut notes = Vec::new();

    let (word, line) = lines.next().ok_or(no_head)?;
    let coordinates = Coordinates::ALL.into_iter().find(|it| it.keyword() == word);
    let coordinates = coordinates.ok_or(TrajectoryFileError { line, problem: TrajectoryFileProblem::Coordinates })?;
    let (word, line) = lines.next().ok_or(no_head)?;
    let count = word.parse::<usize>().ok().filter(|count| (1..=MOST_POSES).contains(count));
    let count = count.ok_or(TrajectoryFileError { line, problem: TrajectoryFileProblem::Count })?;
    let &(word, line) = lines.peek().ok_or(no_head)?;
    let motion = MotionType::ALL.into_iter().find(|it| it.keyword() == word);
    let mut skipped = 0;
    if motion.is_some() {
        lines.next();
    } else {
        let row = RawRow::of((word, line));
        if row.values[0].is_nan() {
            return Err(row.refused(TrajectoryFileProblem::MotionType));
        }
        if row.columns == TEACH_IN {
            return Err(row.refused(TrajectoryFileProblem::TeachIn));
        }
        notes.push(TrajectoryNote::OlderFormat);
        // The first motion begins at rest.
        if row.values.iter().all(|value| *value == 0.0) {
            skipped = OLDEST_ROWS - ROWS.len();
            notes.push(TrajectoryNote::EndVelocities);
        }
    }

    // Rows of the poses. An error of a row counts before a row that is missing.
    let mut raw: Vec<(PoseRow, RawRow)> = Vec::new();
    let mut ended = None;
    'file: for pose in 1..=count {
        for (number, row) in [PoseRow::Velocities; 2][..skipped].iter().chain(&ROWS).enumerate() {
            let Some(line) = lines.next() else {
                ended = Some(TrajectoryFileProblem::Ended { pose, row: *row });
                break 'file;
            };
            if number >= skipped {
                raw.push((*row, RawRow::of(line)));
            }
        }
    }
    let columns = columns(&raw, coordinates, axes)?;
    let mut poses = vec![SmoothPose::fast(Axes::default()); raw.len() / ROWS.len()];
    for (number, (kind, row)) in raw.iter().enumerate() {
        check_row(*kind, &row.values[..columns]).map_err(|problem| row.refused(problem))?;
        if let Some(pose) = poses.get_mut(number / ROWS.len()) {
            let values = kind.of_mut(pose);
            *values = Axes::default();
            values[..columns].copy_from_slice(&row.values[..columns]);
        }
    }
    if let Some(problem) = ended {
        return Err(TrajectoryFileError { line: end, problem });
    }
    let (told, spare) = behind(lines)?;
    if let Some((line, rows)) = spare {
        notes.push(TrajectoryNote::SpareRows { line, rows, poses: count });
    }
    let widest = raw.iter().map(|(_, row)| row.columns).max().unwrap_or_default();
    if widest > columns {
        notes.push(TrajectoryNote::SpareColumns { columns: widest, used: columns });
    }
    let older = motion.is_none().then_some(JointConvention::Inclination);
    let joints = told.or(older).filter(|_| coordinates == Coordinates::Joint);
    let motion = motion.unwrap_or(MotionType::Absolute);
    Ok((TrajectoryFile { coordinates, motion, columns, poses, joints }, notes))
}

/// What the lines behind the poses tell: the convention of the joints, and the first spare line with the number of all.
type Behind = (Option<JointConvention>, Option<(usize, usize)>);

fn behind<'a>(lines: impl Iterator<Item = (&'a str, usize)>) -> Result<Behind, TrajectoryFileError> {
    let (mut told, mut spare) = (None::<(JointConvention, usize)>, None);
    for (text, line) in lines {
        let telling = text.strip_prefix(JOINTS).and_then(|rest| rest.trim_start().strip_prefix('='));
        if let Some(word) = telling {
            let refused = |problem| TrajectoryFileError { line, problem };
            let found = JointConvention::of(word.trim().trim_matches('"'));
            let found = found.ok_or(refused(TrajectoryFileProblem::Joints))?;
            match told {
                Some((told, first)) if told != found => {
                    return Err(refused(TrajectoryFileProblem::TwoConventions { found, told, first }));
                }
                _ => told = told.or(Some((found, line))),
            }
        } else {
            let (first, rows) = spare.unwrap_or((line, 0));
            spare = Some((first, rows + 1));
        }
    }
    Ok((told.map(|(convention, _)| convention), spare))
}

/// The number of columns that are used: those that all rows have, and no more than the robot has.
fn columns(
    raw: &[(PoseRow, RawRow)],
    coordinates: Coordinates,
    axes: Option<usize>,
) -> Result<usize, TrajectoryFileError> {
    let wanted = axes.and_then(|axes| match coordinates {
        Coordinates::Motor | Coordinates::Joint => (axes != 5).then_some(axes),
        // The tool has six coordinates on every robot.
        Coordinates::XyzEulerZyz | Coordinates::XyzAngleAxis => Some(6),
    });
    let mut used = wanted.unwrap_or(MAX_AXES);
    let mut expected = None;
    for (kind, row) in raw {
        let columns = row.columns;
        if columns == 0 || (wanted.is_none() && columns > MAX_AXES) {
            return Err(row.refused(TrajectoryFileProblem::TooWide { columns, max: MAX_AXES }));
        }
        // Fractions of a column that has no coordinate are spare, but a pose without a coordinate is a slip.
        if *kind == PoseRow::Coordinates {
            let expected = *expected.get_or_insert(columns);
            if columns != expected {
                return Err(row.refused(TrajectoryFileProblem::Ragged { columns, expected }));
            }
        }
        used = used.min(columns);
    }
    Ok(used)
}

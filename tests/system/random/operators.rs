//! Alterations of one line of a cell: a table's header, or a key and its value.

use Operator::*;

use kit::draw::Draw;

/// One alteration. Each operator draws a random value of its kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Operator {
    /// The line is missing.
    Deleted,
    /// The line is duplicated.
    Doubled,
    /// The key or the table has another name.
    Renamed,
    /// The key becomes a table around its value. A table becomes an array of tables, and an array a table.
    Nested,
    /// A Boolean value. A Boolean value is inverted.
    TruthValue,
    /// A text of a few characters, in most cases not a valid name.
    Text,
    /// A text of up to 80,000 characters.
    LongText,
    /// The value of another line of the cell.
    Borrowed,
    /// An array around the value or in place of it.
    Array,
    /// Nested arrays, up to 1,280 deep.
    DeepArray,
    /// A table in place of the value.
    Table,
    /// A date, or text that is not a TOML value.
    Malformed,
    /// Zero, positive or negative, as an integer or not.
    Zero,
    /// A number below zero.
    Negative,
    /// A number of one or less.
    Small,
    /// A number at or beyond a bound of integers, or a very large one.
    Large,
    /// Not a number, or infinite.
    NotFinite,
    /// The number is scaled, changes its sign, or changes by 1.
    Scaled,
    /// An element of the array is missing.
    ElementDeleted,
    /// An element of the array is duplicated.
    ElementDoubled,
    /// An element of the array is altered by another operator.
    ElementAltered,
}

/// Operators for the header of a table.
const OF_A_HEADER: [Operator; 4] = [Deleted, Doubled, Renamed, Nested];

/// Operators for a line with a key, independent of its value.
const OF_ANY_KEY: [Operator; 17] = [
    Deleted, Doubled, Renamed, Nested, TruthValue, Text, LongText, Borrowed, Array, DeepArray, Table, Malformed, Zero,
    Negative, Small, Large, NotFinite,
];

/// Additional operators for an array.
const OF_AN_ARRAY: [Operator; 3] = [ElementDeleted, ElementDoubled, ElementAltered];

const ZEROS: [&str; 3] = ["0", "0.0", "-0.0"];

const NEGATIVES: [&str; 6] = ["-1", "-1.0", "-0.001", "-1e300", "-1000.0", "-9223372036854775808"];

const SMALL: [&str; 5] = ["1", "0.5", "0.001", "1e-9", "1e-300"];

const LARGE: [&str; 13] = [
    "2",
    "100.0",
    "127",
    "128",
    "255",
    "256",
    "65535",
    "65536",
    "1e6",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "1e300",
];

const NOT_FINITE: [&str; 3] = ["nan", "inf", "-inf"];

const TRUTH_VALUES: [&str; 2] = ["true", "false"];

const ARRAYS: [&str; 4] = ["[]", "[0]", "[[]]", "[1e300, nan]"];

const TABLES: [&str; 3] = ["{}", "{ a = 1 }", "{ a = { b = [] } }"];

const MALFORMED: [&str; 7] = ["1979-05-27", "9223372036854775808", "1e999", "", "=", "\"open", "[1, 2"];

const TEXTS: [&str; 14] =
    ["", " ", "a", "0", "nan", "a b", "Ünïcödé", "\\u0000", "\\n", "\\u001b[2J", "\\\"", "../../..", "/dev/zero", "/"];

const FACTORS: [f64; 7] = [-1.0, 0.1, 0.5, 0.99, 1.01, 2.0, 10.0];

impl Operator {
    /// The alterations that fit a line.
    pub(super) fn all(line: &str) -> Vec<Self> {
        if line.starts_with('[') {
            return OF_A_HEADER.to_vec();
        }
        let value = value(line);
        let mut all = OF_ANY_KEY.to_vec();
        if value.parse::<f64>().is_ok() {
            all.push(Scaled);
        }
        if value == "[]" {
            all.push(ElementDoubled);
        } else if value.starts_with('[') {
            all.extend(OF_AN_ARRAY);
        }
        all
    }

    /// The line of `cell`, altered.
    pub(super) fn apply(self, draw: &mut Draw, line: &str, cell: &str) -> String {
        (0..1_000)
            .map(|_| self.draw(draw, line, cell))
            .find(|altered| altered != line)
            .unwrap_or_else(|| panic!("{self:?} leaves {line} as it is"))
    }

    /// As [`Operator::apply`], but the result may equal the line.
    fn draw(self, draw: &mut Draw, line: &str, cell: &str) -> String {
        match self {
            Deleted => return String::new(),
            Doubled => return format!("{line}\n{line}"),
            _ => {}
        }
        if line.starts_with('[') {
            let name = line.trim_matches(['[', ']']);
            let (name, array) = match self {
                Renamed => (format!("{name}x"), line.starts_with("[[")),
                _ => (name.to_owned(), !line.starts_with("[[")),
            };
            return if array { format!("[[{name}]]") } else { format!("[{name}]") };
        }
        let (key, before) = line.split_once(" = ").expect("a line with a key");
        match self {
            Renamed => format!("{key}x = {before}"),
            Nested => format!("{key}.a = {before}"),
            _ => format!("{key} = {}", self.value(draw, before, cell)),
        }
    }

    /// A value in place of `before`.
    fn value(self, draw: &mut Draw, before: &str, cell: &str) -> String {
        match self {
            Text => format!("\"{}\"", draw.among(&TEXTS)),
            LongText => format!("\"{}\"", "x".repeat(10 << draw.below(14))),
            Borrowed => {
                let values: Vec<_> = cell.lines().filter_map(|it| it.split_once(" = ")).collect();
                draw.among(&values).1.into()
            }
            Array if draw.one_in(2) => format!("[{before}]"),
            Array => draw.among(&ARRAYS).into(),
            DeepArray => {
                let depth = 10 << draw.below(8);
                format!("{}{}", "[".repeat(depth), "]".repeat(depth))
            }
            TruthValue => draw.among(&TRUTH_VALUES).into(),
            Table => draw.among(&TABLES).into(),
            Malformed => draw.among(&MALFORMED).into(),
            Zero => draw.among(&ZEROS).into(),
            Negative => draw.among(&NEGATIVES).into(),
            Small => draw.among(&SMALL).into(),
            Large => draw.among(&LARGE).into(),
            NotFinite => draw.among(&NOT_FINITE).into(),
            Scaled => scaled(draw, before),
            ElementDeleted | ElementDoubled | ElementAltered => self.elements(draw, before, cell),
            Deleted | Doubled | Renamed | Nested => unreachable!("{self:?} is of a whole line"),
        }
    }

    /// The array with one of its elements altered.
    fn elements(self, draw: &mut Draw, before: &str, cell: &str) -> String {
        let mut elements = elements(before);
        if elements.is_empty() {
            return draw.among(&ARRAYS).into();
        }
        let place = draw.below(elements.len());
        match self {
            ElementDeleted => drop(elements.remove(place)),
            ElementDoubled => elements.insert(place, elements[place].clone()),
            _ => {
                let before = &elements[place];
                // The first four operators alter a whole line.
                let all = Self::all(&format!("element = {before}"));
                elements[place] = draw.among(&all[4..]).value(draw, before, cell);
            }
        }
        format!("[{}]", elements.join(", "))
    }
}

fn value(line: &str) -> &str {
    line.split_once(" = ").map_or("", |(_, value)| value)
}

/// A number near `before`, of the same type.
fn scaled(draw: &mut Draw, before: &str) -> String {
    let number: f64 = before.parse().expect("only numbers are scaled");
    let number = match draw.below(FACTORS.len() + 2) {
        0 => number + 1.0,
        1 => number - 1.0,
        factor => number * FACTORS[factor - 2],
    };
    if before.contains(['.', 'e', 'n']) { format!("{number:?}") } else { format!("{}", number.round() as i64) }
}

/// The elements of an array on one line.
fn elements(array: &str) -> Vec<String> {
    let inner = &array[1..array.len() - 1];
    let mut elements = Vec::new();
    let (mut depth, mut from) = (0, 0);
    for (at, character) in inner.char_indices() {
        match character {
            '[' | '{' => depth += 1,
            ']' | '}' => depth -= 1,
            ',' if depth == 0 => {
                elements.push(inner[from..at].trim().to_owned());
                from = at + 1;
            }
            _ => {}
        }
    }
    elements.push(inner[from..].trim().to_owned());
    elements.retain(|element| !element.is_empty());
    elements
}

//! Conformance of the emulated drive. Each claimed object and service of CiA 301, CiA 305 and CiA 402 has a check.
//!
//! [`TABLE`] lists the claims. Each check uses a drive of its own, byte by byte, in virtual time. The table is written
//! as JSON to `target/conformance.json` and as Markdown to `docs/conformance.md`.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;

use canopen::eds::Eds;
use kit::mrroc::root;
use rig::{Bench, Rig, Verdict};

mod block;

mod cyclic;

mod drive;

mod emergency;

mod error_control;

mod homing;

mod identification;

mod lss;

mod mapping;

mod nmt;

mod objects;

mod options;

mod pdo;

mod position;

mod power;

mod profile;

mod rig;

mod sdo;

mod store;

mod sync;

mod transmission;

mod velocity;

/// A standard and the version whose sections are cited.
#[derive(Clone, Copy)]
struct Standard {
    name: &'static str,
    version: &'static str,
}

const CIA_301: Standard = Standard { name: "CiA 301", version: "4.2.0" };

const CIA_305: Standard = Standard { name: "CiA 305", version: "3.0.0" };

const CIA_402_2: Standard = Standard { name: "CiA 402-2", version: "4" };

const CIA_402_3: Standard = Standard { name: "CiA 402-3", version: "4" };

/// One claim.
struct Row {
    id: &'static str,
    standard: Standard,
    /// Number of the section or table; empty where the number could not be verified.
    section: &'static str,
    service: &'static str,
    objects: &'static [u16],
    claim: &'static str,
    check: fn(&mut Rig) -> Verdict,
}

impl Standard {
    const fn row(
        self,
        id: &'static str,
        section: &'static str,
        (service, objects): (&'static str, &'static [u16]),
        claim: &'static str,
        check: fn(&mut Rig) -> Verdict,
    ) -> Row {
        Row { id, standard: self, section, service, objects, claim, check }
    }
}

/// The rows by subject.
const TABLE: &[(&str, &[Row])] = &[
    ("Object dictionary", objects::ROWS),
    ("NMT", nmt::ROWS),
    ("Error control", error_control::ROWS),
    ("SDO", sdo::ROWS),
    ("SDO block transfer", block::ROWS),
    ("SYNC", sync::ROWS),
    ("PDO parameters", pdo::ROWS),
    ("PDO mapping", mapping::ROWS),
    ("PDO transmission", transmission::ROWS),
    ("EMCY", emergency::ROWS),
    ("Stored parameters", store::ROWS),
    ("LSS states and configuration", lss::ROWS),
    ("LSS identification", identification::ROWS),
    ("Power states", power::ROWS),
    ("Option codes", options::ROWS),
    ("Profile position", position::ROWS),
    ("Profiles and limits", profile::ROWS),
    ("Profile velocity", velocity::ROWS),
    ("Homing", homing::ROWS),
    ("Cyclic synchronous modes", cyclic::ROWS),
];

/// One row after its run.
struct Outcome {
    row: &'static Row,
    /// The deviation, with the frames before it; `None` if the claim holds.
    deviation: Option<String>,
}

fn rows() -> impl Iterator<Item = &'static Row> {
    TABLE.iter().flat_map(|(_, rows)| *rows)
}

/// Runs every row on a bench of its own.
fn run(bench: Bench) -> Vec<Outcome> {
    rows()
        .map(|row| {
            let mut rig = Rig::new(bench);
            let deviation = (row.check)(&mut rig).err().map(|deviation| format!("{}\n{}", deviation.0, rig.tail()));
            Outcome { row, deviation }
        })
        .collect()
}

fn json(outcomes: &[Outcome]) -> String {
    let rows: Vec<_> = outcomes
        .iter()
        .map(|Outcome { row, deviation }| {
            serde_json::json!({
                "id": row.id,
                "standard": row.standard.name,
                "version": row.standard.version,
                "section": row.section,
                "service": row.service,
                "objects": row.objects.iter().map(|index| format!("{index:#06x}")).collect::<Vec<_>>(),
                "claim": row.claim,
                "holds": deviation.is_none(),
                "deviation": deviation,
            })
        })
        .collect();
    serde_json::to_string_pretty(&rows).expect("strings and truth values")
}

/// The page of the table.
fn page(outcomes: &[Outcome]) -> String {
    let mut text = String::from(HEADING);
    let holding = outcomes.iter().filter(|outcome| outcome.deviation.is_none()).count();
    let _ = writeln!(text, "\n{holding} of {} claims hold.", outcomes.len());
    let mut outcomes = outcomes.iter();
    for (subject, rows) in TABLE {
        let _ = writeln!(
            text,
            "\n## {subject}\n\n| id | standard | object or service | claim | result |\n|---|---|---|---|---|"
        );
        for Outcome { row, deviation } in outcomes.by_ref().take(rows.len()) {
            let section = match row.section {
                "" => String::new(),
                table if table.starts_with("Table") => format!(", {table}"),
                number => format!(" §{number}"),
            };
            let objects: Vec<_> = row.objects.iter().map(|index| format!("0x{index:04X}")).collect();
            let subject = match (row.service, objects.join(", ")) {
                (service, objects) if objects.is_empty() => service.to_owned(),
                ("", objects) => objects,
                (service, objects) => format!("{service}: {objects}"),
            };
            let result = if deviation.is_none() { "holds" } else { "fails" };
            let _ = writeln!(
                text,
                "| {} | {}{section} | {subject} | {} | {result} |",
                row.id, row.standard.name, row.claim
            );
        }
    }
    text
}

const HEADING: &str = "# Conformance of the emulated drive

The emulated drive claims the objects of [`cells/epos4-emulated.eds`](../cells/epos4-emulated.eds) and the services below. Each row is a check of
`tests/system/conformance`: a client builds its frames byte by byte from the standard and compares the answers, in virtual time, with a fresh drive
for each row. The column *result* comes from a run. `MRROC_WRITE_DOCS=1 cargo test -p mrroc-tests --test system conformance` writes this page.

Sections are those of CiA 301 version 4.2.0 and CiA 305 version 3.0.0. Rows without a section cite the object or service by its name. These checks
do not replace the conformance test of CAN in Automation.
";

/// Runs the table once for all tests of this module.
fn outcomes() -> &'static [Outcome] {
    static OUTCOMES: std::sync::OnceLock<Vec<Outcome>> = std::sync::OnceLock::new();
    OUTCOMES.get_or_init(|| run(Bench::Drive))
}

#[test]
fn every_claim_of_the_emulated_drive_holds() {
    let outcomes = outcomes();
    let target = root().join("target");
    fs::create_dir_all(&target).unwrap();
    fs::write(target.join("conformance.json"), json(outcomes)).unwrap();
    let failures: Vec<_> = outcomes
        .iter()
        .filter_map(|outcome| Some((outcome.row, outcome.deviation.as_ref()?)))
        .map(|(row, deviation)| {
            format!("{} ({} {}): {}\n  {deviation}", row.id, row.standard.name, row.section, row.claim)
        })
        .collect();
    assert!(failures.is_empty(), "{} of {} claims fail:\n{}", failures.len(), outcomes.len(), failures.join("\n"));
}

#[test]
fn no_claim_holds_on_a_bus_without_the_drive() {
    let holding: Vec<_> =
        run(Bench::Empty).iter().filter(|outcome| outcome.deviation.is_none()).map(|outcome| outcome.row.id).collect();
    assert_eq!(holding, [""; 0]);
}

#[test]
fn the_page_of_the_claims_is_current() {
    let path = root().join("docs/conformance.md");
    let page = page(outcomes());
    if std::env::var_os("MRROC_WRITE_DOCS").is_some() {
        fs::write(&path, &page).unwrap();
    }
    let kept = fs::read_to_string(&path).unwrap_or_default();
    assert!(kept == page, "{} is out of date: run this test with MRROC_WRITE_DOCS=1", path.display());
}

#[test]
fn every_object_of_the_profiles_is_claimed_by_a_row() {
    let sheet = fs::read(root().join("cells/epos4-emulated.eds")).unwrap();
    let sheet = Eds::read(&sheet).unwrap();
    let claimed: BTreeSet<u16> = rows().flat_map(|row| row.objects).copied().collect();
    let profiles = |index: &u16| matches!(index, 0x1000..=0x1FFF | 0x6000..=0x6FFF);
    let unclaimed: Vec<_> = sheet
        .objects
        .keys()
        .filter(|index| profiles(index) && !claimed.contains(index))
        .map(|index| format!("{index:#06x}"))
        .collect();
    assert!(unclaimed.is_empty(), "no row names {}", unclaimed.join(", "));
    let unknown: Vec<_> = claimed
        .iter()
        .filter(|index| !sheet.objects.contains_key(index))
        .map(|index| format!("{index:#06x}"))
        .collect();
    assert!(unknown.is_empty(), "the data sheet lacks {}", unknown.join(", "));
}

#[test]
fn rows_have_ids_of_their_own_and_there_are_at_least_100() {
    let ids: BTreeSet<_> = rows().map(|row| row.id).collect();
    assert_eq!(ids.len(), rows().count(), "an id is used twice");
    assert!(ids.len() >= 100, "{} rows", ids.len());
}

#[test]
fn the_crc_of_block_transfers_has_the_check_value_of_the_standard() {
    // CiA 301 §7.2.4.3.16.
    assert_eq!(block::crc(b"123456789"), 0x31C3);
}

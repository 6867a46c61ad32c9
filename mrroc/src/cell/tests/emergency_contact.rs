//! Contacts of the emergency stop at drives.

use super::*;

/// The first drive with these keys.
fn with(keys: &str) -> String {
    let drive = "counts_per_revolution = ";
    IRB6.replacen(drive, &format!("emergency_stop = {{ {keys} }}, {drive}"), 1)
}

#[test]
fn a_contact_has_a_free_bit_and_ascending_edges() {
    let cell = Cell::parse(&with("input = 31, emulated_edges_s = [1.0, 2.0]")).unwrap();
    assert_eq!(cell.robot[0].axis[0].drive_config(0.0).emergency_input, Some(31));
    assert_eq!(cell.robot[0].axis[1].drive_config(0.0).emergency_input, None);
    for (keys, expected) in [
        ("input = 2", "robot[0].axis[0].drive.emergency_stop.input: is 2, must be between 3 and 31"),
        ("input = 32", "robot[0].axis[0].drive.emergency_stop.input: is 32, must be between 3 and 31"),
        (
            "input = 16, emulated_edges_s = [2.0, 1.0]",
            "robot[0].axis[0].drive.emergency_stop.emulated_edges_s[1]: is not later than the edge before",
        ),
        ("line = 16", "robot[0].axis[0].drive.emergency_stop.line: is an unknown key"),
    ] {
        let shown = Cell::parse(&with(keys)).expect_err(keys).to_string();
        assert!(shown.contains(expected), "{keys}: {shown}");
    }
}

//! Objects that "save" stores, and objects that "save" does not store.

use super::*;

#[test]
fn what_is_no_parameter_is_not_stored() {
    let mut bench = Bench::booted(config());
    // An error without effect on the motion.
    bench.write("076000", 0, 2);
    bench.say("000#0102");
    bench.say("202#");
    bench.say("000#8002");
    assert_eq!(bench.read("031000"), 1);
    // Commands, set-points, offsets, outputs.
    let volatile = [
        ("406000", 0x06, 2),
        ("716000", 11, 2),
        ("7A6000", 12, 4),
        ("B06000", 13, 4),
        ("B16000", 14, 4),
        ("B26000", 15, 2),
        ("FE6001", 0x1_0000, 4),
        ("FF6000", 16, 4),
    ];
    let parameters = [
        ("161001", 127 << 16 | 1000, 4),
        ("171000", 1000, 2),
        ("606000", 3, 1),
        ("656000", 77, 4),
        ("816000", 78, 4),
        ("986000", 37, 1),
        ("B03000", 79, 4),
        ("FE6002", 0x1_0000, 4),
    ];
    for (object, value, bytes) in volatile.into_iter().chain(parameters) {
        bench.write(object, value, bytes);
    }
    bench.write("101001", 0x6576_6173, 4);
    bench.say("000#8102");
    bench.run(60);
    assert_eq!(bench.ask("4003100000000000"), "4F03100000000000");
    assert_eq!(bench.ask("4003100100000000"), "8003100124000008");
    assert_eq!(bench.read("011000"), 0);
    assert_eq!(bench.read("3F6000"), 0);
    for (object, ..) in volatile {
        assert_eq!(bench.read(object), 0, "{object}");
    }
    for (object, value, _) in parameters {
        assert_eq!(i64::from(bench.read(object)), value, "{object}");
    }
}

#[test]
fn what_is_not_stored_is_what_the_data_sheet_keeps_from_downloads() {
    use crate::epos4::table::TABLE;
    let sheet = Epos4::eds(&config());
    let kept: Vec<_> =
        sheet.variables().filter(|(_, variable)| variable.refuses_download).map(|(object, _)| object).collect();
    let volatile = TABLE.iter().filter(|entry| entry.volatile);
    let volatile: Vec<_> =
        volatile.inspect(|entry| assert!(entry.writable, "{}", entry.object)).map(|entry| entry.object).collect();
    assert_eq!(kept, volatile);
}

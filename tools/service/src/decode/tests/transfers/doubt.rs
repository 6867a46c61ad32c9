//! Frames that may be commands or segments of a block transfer, and the frames that resolve the ambiguity.

use super::*;

#[test]
fn a_client_that_began_anew_without_a_word_is_understood_after_its_time_out() {
    // Number of segments before the silence, and the text of the frame after it.
    for (segments, text) in [(10, WRITTEN), (42, UNKNOWN)] {
        let mut decoder = Decoder::default();
        let at = download(&mut decoder, segments);
        tell(
            &mut decoder,
            &[
                (at + 1_500, CONTROLWORD, text),
                (at + 1_501, "586#6040600000000000", "0x6040:00 controlword taken"),
                (at + 1_502, CONTROLWORD, WRITTEN),
            ],
        );
    }
    // Before the silence, a frame out of order may be a command or a segment. The answer to the frame decides.
    let mut decoder = Decoder::default();
    let at = download(&mut decoder, 10);
    tell(
        &mut decoder,
        &[
            (at, CONTROLWORD, UNKNOWN),
            (at, "606#2C00000000000000", "unknown, a command or segment 44 of a block: 2c 00 00 00 00 00 00 00"),
            (at, CONTROLWORD, UNKNOWN),
            (at, "586#6040600000000000", "0x6040:00 controlword taken"),
            (at, CONTROLWORD, WRITTEN),
        ],
    );
    // No segment is due after a complete sub-block.
    let mut decoder = Decoder::default();
    let at = download(&mut decoder, 127);
    tell(&mut decoder, &[(at, CONTROLWORD, WRITTEN)]);
}

#[test]
fn a_client_that_leaves_a_block_upload_is_understood_once_it_is_answered() {
    tell(
        &mut Decoder::default(),
        &[
            (0, "606#A40810007F000000", "read NAME in blocks of 127"),
            (1, "586#C608100000020000", "NAME in blocks, 512 bytes"),
            (2, "606#A300000000000000", "first block, please"),
            (3, "586#0102030405060708", "segment 1 of NAME: 02 03 04 05 06 07 08"),
            (4, "606#4041600000000000", "read 0x6041:00 statusword"),
            (5, "586#0202030405060708", "unknown, an answer or segment 2 of a block: 02 02 03 04 05 06 07 08"),
            (6, "606#4041600000000000", "unknown, a command or segment 64 of a block: 40 41 60 00 00 00 00 00"),
            (7, "586#4B41600037060000", "0x6041:00 statusword = 0x0637, 1591 (operation enabled, target reached)"),
            (8, CONTROLWORD, WRITTEN),
        ],
    );
}

#[test]
fn a_monitor_that_begins_in_the_middle_of_a_transfer_does_not_guess() {
    // A download that is already under way ends.
    tell(
        &mut listening(),
        &[
            (1, CONTROLWORD, UNKNOWN),
            (2, "606#AC40600006000000", "unknown, a command or segment 44 of a block: ac 40 60 00 06 00 00 00"),
            (3, "586#A22C7F0000000000", "block taken up to segment 44, next of 127"),
            (4, "606#C131C30000000000", "end of blocks, checksum 0xc331"),
            (5, "586#A100000000000000", "end of blocks taken"),
            (6, CONTROLWORD, WRITTEN),
        ],
    );
    // A download goes on after an acknowledgement.
    tell(
        &mut listening(),
        &[
            (1, "606#7F40600006000000", "unknown, a command or segment 127 of a block: 7f 40 60 00 06 00 00 00"),
            (2, "586#A27F020000000000", "block taken up to segment 127, next of 2"),
            (3, "606#0140600006000000", "segment 1 of a block: 40 60 00 06 00 00 00"),
            (4, "606#0240600006000000", "segment 2 of a block: 40 60 00 06 00 00 00"),
            (5, "586#A202020000000000", "block taken up to segment 2, next of 2"),
        ],
    );
    // An upload seen from its acknowledgement on, and an upload seen from its start on.
    tell(
        &mut listening(),
        &[
            (1, "586#4341600037060000", "unknown, an answer or segment 67 of a block: 43 41 60 00 37 06 00 00"),
            (2, "606#A243430000000000", "block taken up to segment 67, next of 67"),
            (3, "586#8141600037060000", "last segment 1 of a block: 41 60 00 37 06 00 00"),
            (4, "606#A201430000000000", "block taken up to segment 1, next of 67"),
            (5, "586#C131C30000000000", "end of blocks, checksum 0xc331"),
            (6, "606#A100000000000000", "end of blocks taken"),
            (7, "606#4041600000000000", "read 0x6041:00 statusword"),
        ],
    );
    tell(
        &mut listening(),
        &[
            (1, "606#A300000000000000", "unknown, a command or segment 35 of a block: a3 00 00 00 00 00 00 00"),
            (2, "586#0141600037060000", "segment 1 of a block: 41 60 00 37 06 00 00"),
            (3, "606#A201430000000000", "block taken up to segment 1, next of 67"),
        ],
    );
    // Ordinary segments, download and upload.
    tell(
        &mut listening(),
        &[
            (1, "606#1045504F53342D45", "unknown, a command or segment 16 of a block: 10 45 50 4f 53 34 2d 45"),
            (2, "586#3000000000000000", "segment taken"),
            (3, "606#0D41000000000000", "last segment 41 \"A\""),
            (4, "586#2000000000000000", "segment taken"),
            (5, CONTROLWORD, WRITTEN),
        ],
    );
    tell(
        &mut listening(),
        &[
            (1, "606#7000000000000000", "unknown, a command or segment 112 of a block: 70 00 00 00 00 00 00 00"),
            (2, "586#1545504F53340000", "last segment 45 50 4f 53 34 \"EPOS4\""),
            (3, CONTROLWORD, WRITTEN),
        ],
    );
}

#[test]
fn an_exchange_that_fits_one_kind_of_transfer_alone_ends_the_doubt() {
    // A command and its answer.
    tell(
        &mut listening(),
        &[
            (1, CONTROLWORD, UNKNOWN),
            (2, "586#6040600000000000", "0x6040:00 controlword taken"),
            (3, CONTROLWORD, WRITTEN),
        ],
    );
    // An answer for another object does not answer the command. An acknowledgement of another segment does not fit
    // either.
    tell(
        &mut listening(),
        &[
            (1, CONTROLWORD, UNKNOWN),
            (2, "586#6041600000000000", "unknown, an answer or segment 96 of a block: 60 41 60 00 00 00 00 00"),
            (3, CONTROLWORD, UNKNOWN),
            (4, "586#A22A7F0000000000", "unknown, an answer or segment 34 of a block: a2 2a 7f 00 00 00 00 00"),
        ],
    );
    // An abort and a frame whose first byte is zero are never segments of a block transfer.
    tell(
        &mut listening(),
        &[
            (1, CONTROLWORD, UNKNOWN),
            (2, "606#0045504F53342D45", "segment 45 50 4f 53 34 2d 45 \"EPOS4-E\""),
            (3, "606#8008100000000405", "client aborts NAME: 0x05040000 (SDO protocol timed out)"),
            (4, CONTROLWORD, WRITTEN),
        ],
    );
    // A silence longer than every time-out.
    tell(
        &mut listening(),
        &[(999, CONTROLWORD, UNKNOWN), (1_998, CONTROLWORD, UNKNOWN), (2_998, CONTROLWORD, WRITTEN)],
    );
    tell(&mut listening(), &[(1_000, CONTROLWORD, WRITTEN)]);
}

#[test]
fn after_a_loss_of_frames_every_transfer_is_in_doubt() {
    let mut decoder = Decoder::default();
    tell(&mut decoder, &[(0, "606#210810000A000000", "write NAME, 10 bytes in segments")]);
    decoder.begin(Instant::from_nanos(5_000_000));
    tell(&mut decoder, &[(6, CONTROLWORD, UNKNOWN), (2_000, CONTROLWORD, WRITTEN)]);
}

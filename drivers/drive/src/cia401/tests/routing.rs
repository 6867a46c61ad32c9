//! Routing: no frame is lost or taken twice, whatever the mixture.

use proptest::prelude::*;

use super::bench::*;

const DRIVES: [u8; 2] = [2, 3];
const NODES: [u8; 2] = [5, 6];

#[derive(Clone, Copy, Debug)]
enum Sent {
    /// Position of a drive, within the reach of its motor from the last one.
    Answer(usize, i16),
    /// Inputs of an I/O node.
    Inputs(usize, u8),
    /// A frame of a node that is none of the bus, or that no node sends.
    Strange(u16),
}

fn sent() -> impl Strategy<Value = Sent> {
    let strange =
        prop_oneof![Just(0x184), Just(0x287), Just(0x485), Just(0x382), Just(0x604), Just(0x100), Just(0x7E4)];
    prop_oneof![
        (0..2_usize, -1_000..1_000_i16).prop_map(|(drive, position)| Sent::Answer(drive, position)),
        (0..2_usize, any::<u8>()).prop_map(|(node, levels)| Sent::Inputs(node, levels)),
        strange.prop_map(Sent::Strange),
    ]
}

fn text(sent: Sent) -> String {
    match sent {
        Sent::Answer(drive, position) => answer(DRIVES[drive], 0x0740, position.into()),
        Sent::Inputs(node, levels) => format!("{:03X}#{levels:02X}02", 0x180 + u16::from(NODES[node])),
        Sent::Strange(id) => format!("{id:03X}#0102"),
    }
}

proptest! {
    #[test]
    fn every_frame_has_its_effect_once(cycles in prop::collection::vec(prop::collection::vec(sent(), 0..60), 1..6)) {
        let nodes = NODES.map(io_config);
        let axes = DRIVES.map(axis_config);
        let stores = NODES.map(io_store).into();
        let mut bench = Bench::up_with_io(group_config(), &axes, &nodes, stores);
        bench.cycle(NONE, &[AxisCommand::Off; 2]);
        let (mut levels, mut edges) = ([1_u8; 2], [[0_u64; 8]; 2]);
        let (mut positions, mut unexpected) = ([None; 2], 0);
        for frames in &cycles {
            for sent in frames {
                match *sent {
                    Sent::Answer(drive, position) => positions[drive] = Some(i32::from(position)),
                    Sent::Inputs(node, new) => {
                        for (input, count) in edges[node].iter_mut().enumerate() {
                            *count += u64::from((levels[node] ^ new) >> input & 1);
                        }
                        levels[node] = new;
                    }
                    Sent::Strange(_) => unexpected += 1,
                }
            }
            let frames: Vec<_> = frames.iter().copied().map(text).collect();
            bench.cycle(&frames, &[AxisCommand::Off; 2]);
            // A cycle reads a bounded number of frames; the others wait.
            while !bench.bus.0.lock().unwrap().inbox.is_empty() {
                bench.cycle(NONE, &[AxisCommand::Off; 2]);
            }
        }
        prop_assert_eq!(bench.group.counters().unexpected, unexpected);
        for (drive, position) in positions.into_iter().enumerate() {
            if let Some(position) = position {
                prop_assert_eq!(bench.states[drive].increments.0, position);
            }
        }
        for (node, edges) in edges.iter().enumerate() {
            let image = bench.links[node].inputs.read();
            for (number, edges) in edges.iter().enumerate() {
                let input = image.input(number as u8).unwrap();
                prop_assert_eq!((input.level, input.edges), (levels[node] >> number & 1 == 1, *edges));
            }
        }
    }
}

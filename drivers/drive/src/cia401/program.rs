//! The steps of an I/O node's bring-up, in order.

use canopen::cia401::{Array, INTERRUPT_ENABLE, blocks};
use canopen::objects::ERROR_BEHAVIOUR;
use canopen::pdo::{PdoCobId, PdoKind, PdoMapping, PdoNumber, TransmissionType};
use canopen::sdo::Write;
use canopen::{NodeId, cob};
use master::pdo::{PdoSetup, remap};

use super::config::IoConfig;
use crate::bus::{Need, Step};
use crate::cia402::{ConfigError, GroupConfig};

/// Object 0x1029:1: the node enters the state stopped when the connection is lost (CiA 301 §7.5.2.32). CiA 401 defines
/// the error state of outputs for this state.
const STOP: u8 = 2;

/// All steps before an I/O node is started.
pub(crate) fn program(group: &GroupConfig, io: &IoConfig) -> Result<Vec<Step>, ConfigError> {
    let (inputs, outputs) = (blocks(io.inputs), blocks(io.outputs));
    let mut steps: Vec<Step> = Step::identity(&io.identity).collect();
    let needed = [(Array::Input, inputs), (Array::Output, outputs)].into_iter().filter(|(_, needed)| *needed > 0);
    steps.extend(needed.map(|(array, needed)| Step::Blocks(array.count(), needed)));
    let settings = io.configuration.iter().enumerate();
    steps.extend(settings.map(|(number, setting)| Step::Configure(setting.object, number)));
    steps.extend(Step::heartbeats(group)?);
    let stop = Write::new(ERROR_BEHAVIOUR, STOP);
    // A node without outputs has no error state.
    steps.push(if outputs > 0 { Step::required(stop) } else { Step::optional(stop) });
    if inputs > 0 {
        steps.push(Step::optional(Write::new(INTERRUPT_ENABLE, 1_u8)));
    }
    let filters = io.filtered_inputs.to_le_bytes();
    for block in 1..=inputs {
        let filter = filters[usize::from(block) - 1];
        let write = Write::new(Array::InputFilter.block(block), filter);
        // A node without filters filters no input.
        steps.push(if filter == 0 { Step::optional(write) } else { Step::required(write) });
        // Any change sends, whatever the node has stored.
        let settings = [
            (Array::InputPolarity, 0_u8),
            (Array::InterruptAnyChange, 0xFF),
            (Array::InterruptLowToHigh, 0),
            (Array::InterruptHighToLow, 0),
        ];
        steps.extend(settings.map(|(array, value)| Step::optional(Write::new(array.block(block), value))));
    }
    // The node inverts no output: the error value is the level at the terminal.
    let [mode, value] = [io.error_mode, io.error_value ^ io.inverted_outputs].map(u64::to_le_bytes);
    for block in 1..=outputs {
        let index = usize::from(block) - 1;
        let settings = [(Array::OutputPolarity, 0_u8), (Array::OutputFilter, 0xFF)];
        steps.extend(settings.map(|(array, value)| Step::optional(Write::new(array.block(block), value))));
        let settings = [(Array::ErrorMode, mode[index]), (Array::ErrorValue, value[index])];
        steps.extend(settings.map(|(array, value)| Step::required(Write::new(array.block(block), value))));
    }
    steps.extend(process_data(io)?);
    Ok(steps)
}

/// The PDOs of a node: RPDO 1 with the outputs and TPDO 1 with the inputs. Bring-up switches off a PDO with an empty
/// mapping.
pub fn pdo_setups(io: &IoConfig) -> Result<[PdoSetup; 2], ConfigError> {
    let entries = |array: Array, count| {
        let entries: Vec<_> = (1..=count).map(|block| array.entry(block)).collect();
        PdoMapping::new(&entries).expect("at most eight blocks")
    };
    let [rpdo, tpdo] = [PdoKind::Rpdo, PdoKind::Tpdo].map(|kind| cob_id(kind, PdoNumber::One, io.node));
    let outputs = PdoSetup {
        kind: PdoKind::Rpdo,
        number: PdoNumber::One,
        cob_id: rpdo,
        mapping: entries(Array::Output, blocks(io.outputs)),
        transmission: TransmissionType::EVENT_PROFILE,
        inhibit_time: None,
        // No deadline: unchanged outputs are repeated by the heartbeat period only.
        event_timer: Some(0),
    };
    let inputs = PdoSetup {
        kind: PdoKind::Tpdo,
        cob_id: tpdo,
        mapping: entries(Array::Input, blocks(io.inputs)),
        inhibit_time: Some(io.inhibit_units()?),
        event_timer: Some(io.event_timer_ms()?),
        ..outputs
    };
    Ok([outputs, inputs])
}

/// TPDO 1 with the inputs, RPDO 1 with the outputs, and no other PDO.
fn process_data(io: &IoConfig) -> Result<Vec<Step>, ConfigError> {
    // A node without a deadline of RPDOs has none to switch off.
    let deadline = PdoKind::Rpdo.communication(PdoNumber::One, 5);
    let mut steps = Vec::new();
    for setup in pdo_setups(io)? {
        let used = !setup.mapping.entries().is_empty();
        for number in PdoNumber::ALL.into_iter().filter(|number| !used || *number != setup.number) {
            let off = cob_id(setup.kind, number, io.node).invalid();
            // A PDO that the node lacks is off.
            steps.push(Step::optional(Write::new(setup.kind.communication(number, 1), off.0)));
        }
        if used {
            let need = |write: &Write| if write.object == deadline { Need::Optional } else { Need::Required };
            steps.extend(remap(&setup).map(|write| Step::Set(write, need(&write))));
        }
    }
    Ok(steps)
}

fn cob_id(kind: PdoKind, number: PdoNumber, node: NodeId) -> PdoCobId {
    match kind {
        PdoKind::Rpdo => PdoCobId::new(cob::rpdo(number, node)),
        PdoKind::Tpdo => PdoCobId::new(cob::tpdo(number, node)).without_rtr(),
    }
}

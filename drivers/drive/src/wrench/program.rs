//! The steps of the bring-up of a force/torque sensor on a CAN bus, in order.

use canopen::cob;
use canopen::pdo::{PdoCobId, PdoKind, PdoNumber};
use canopen::sdo::Write;
use master::pdo::remap;

use super::config::ConfigError;
use super::node_config::WrenchNodeConfig;
use crate::bus::{Need, Step};
use crate::cia402::GroupConfig;

/// Index of the first mapping parameter of a TPDO.
const MAPPINGS: u16 = 0x1A00;

/// Sub-index of the inhibit time of a PDO.
const INHIBIT_TIME: u8 = 3;

/// All steps before a sensor is started.
pub(crate) fn program(group: &GroupConfig, config: &WrenchNodeConfig) -> Result<Vec<Step>, ConfigError> {
    let mut steps: Vec<Step> = config.identity.iter().flat_map(Step::identity).collect();
    let settings = config.configuration.iter().enumerate();
    steps.extend(settings.map(|(number, setting)| Step::Configure(setting.object, number)));
    let [producer, consumer] = Step::heartbeats(group)?;
    steps.push(producer);
    // A sensor moves nothing, so the sensor need not supervise the heartbeat of the host.
    steps.push(match consumer {
        Step::Set(write, _) => Step::optional(write),
        other => other,
    });
    for number in PdoNumber::ALL.into_iter().filter(|number| config.pdos.iter().all(|pdo| pdo.number != *number)) {
        let off = PdoCobId::new(cob::tpdo(number, config.node)).without_rtr().invalid();
        // The step is optional, because a node may lack the PDO.
        steps.push(Step::optional(Write::new(PdoKind::Tpdo.communication(number, 1), off.0)));
    }
    for (pdo, setup) in config.pdos.iter().zip(config.pdo_setups()?) {
        let writes = remap(&setup).filter(|write| pdo.mapped || write.object.index < MAPPINGS);
        let need = |write: &Write| {
            let inhibit = write.object.index < MAPPINGS && write.object.subindex == INHIBIT_TIME;
            // The write is optional, because a node may lack the inhibit time.
            if inhibit { Need::Optional } else { Need::Required }
        };
        steps.extend(writes.map(|write| Step::Set(write, need(&write))));
    }
    Ok(steps)
}

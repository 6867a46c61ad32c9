//! The routing table of a bus: from the node-ID of an identifier to a drive, an I/O node or a sensor.

use canopen::NodeId;

/// Place of a node in its list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Index of a drive.
    Drive(usize),
    /// Index of an I/O node.
    Io(usize),
    /// Index of a force/torque sensor.
    Sensor(usize),
}

/// The places of the nodes of one bus, by node-ID.
///
/// The identifiers of the predefined connection set carry the node-ID in their low seven bits (CiA 301 §7.3.3).
/// Bring-up sets the identifiers of the PDOs to this set.
#[derive(Clone, Debug)]
pub(crate) struct Routes {
    places: [Option<Place>; 128],
    drives: usize,
    io: usize,
}

impl Routes {
    /// The routes of the nodes of a bus, in the order of their lists. The node-IDs differ.
    pub(crate) fn new(
        drives: impl IntoIterator<Item = NodeId>,
        io: impl IntoIterator<Item = NodeId>,
        sensors: impl IntoIterator<Item = NodeId>,
    ) -> Self {
        let mut routes = Self { places: [None; 128], drives: 0, io: 0 };
        for (index, node) in drives.into_iter().enumerate() {
            routes.places[usize::from(node.raw())] = Some(Place::Drive(index));
            routes.drives = index + 1;
        }
        for (index, node) in io.into_iter().enumerate() {
            routes.places[usize::from(node.raw())] = Some(Place::Io(index));
            routes.io = index + 1;
        }
        for (index, node) in sensors.into_iter().enumerate() {
            routes.places[usize::from(node.raw())] = Some(Place::Sensor(index));
        }
        routes
    }

    /// The place of a node; `None` for a node of another controller.
    pub(crate) fn place(&self, node: NodeId) -> Option<Place> {
        self.places[usize::from(node.raw())]
    }

    /// The place of a node in the list of all nodes, in which the I/O nodes follow the drives,
    /// and the sensors follow the I/O nodes.
    pub(crate) fn member(&self, node: NodeId) -> Option<usize> {
        Some(match self.place(node)? {
            Place::Drive(index) => index,
            Place::Io(index) => self.drives + index,
            Place::Sensor(index) => self.drives + self.io + index,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use proptest::sample::subsequence;

    use super::*;

    proptest! {
        #[test]
        fn every_node_has_one_place_and_no_other_node_has_one(
            nodes in subsequence((1..=127_u8).collect::<Vec<_>>(), 1..=126).prop_shuffle(),
            drives in 0..=126_usize,
            io in 0..=126_usize,
        ) {
            let node = |raw: &u8| NodeId::new(*raw).unwrap();
            let (drives, others) = nodes.split_at(drives.min(nodes.len()));
            let (io, sensors) = others.split_at(io.min(others.len()));
            let routes = Routes::new(drives.iter().map(node), io.iter().map(node), sensors.iter().map(node));
            for (index, raw) in drives.iter().enumerate() {
                prop_assert_eq!(routes.place(node(raw)), Some(Place::Drive(index)));
            }
            for (index, raw) in io.iter().enumerate() {
                prop_assert_eq!(routes.place(node(raw)), Some(Place::Io(index)));
            }
            for (index, raw) in sensors.iter().enumerate() {
                prop_assert_eq!(routes.place(node(raw)), Some(Place::Sensor(index)));
            }
            for (member, raw) in nodes.iter().enumerate() {
                prop_assert_eq!(routes.member(node(raw)), Some(member));
            }
            let known = NodeId::all().filter(|node| routes.place(*node).is_some()).count();
            prop_assert_eq!(known, nodes.len());
        }
    }
}

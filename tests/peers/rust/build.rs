//! Turns the object dictionary of the zencan node into code.

fn main() {
    let built = zencan_build::build_node_from_device_config("ZENCAN_NODE", "zencan-node.toml");
    built.expect("zencan-node.toml describes a node");
}

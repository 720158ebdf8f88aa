//! Identifiers of the CANopen predefined connection set (CiA 301). The node (1 to 126) is added to all but NMT.

/// Network management, host to all rigs.
pub(crate) const NMT: u16 = 0x000;
/// Emergency, rig to host.
pub(crate) const EMERGENCY: u16 = 0x080;
/// TPDO1, rig to host.
pub(crate) const SAMPLE: u16 = 0x180;
/// RPDO1, host to rig.
pub(crate) const COMMAND: u16 = 0x200;
/// TPDO2, rig to host.
pub(crate) const STATUS: u16 = 0x280;
/// RPDO2, host to rig.
pub(crate) const LEASE: u16 = 0x300;
/// RPDO3, host to rig.
pub(crate) const REQUEST: u16 = 0x400;
/// SDO answer, rig to host.
pub(crate) const CONFIG_ANSWER: u16 = 0x580;
/// SDO request, host to rig.
pub(crate) const CONFIG_REQUEST: u16 = 0x600;
/// Heartbeat, rig to host.
pub(crate) const HEARTBEAT: u16 = 0x700;
/// Largest identifier of 11 bits.
pub(crate) const ID_MAX: u16 = 0x7FF;
/// The bits of an identifier that hold the function; the other seven hold the node.
const FUNCTION_MASK: u16 = 0x780;

/// The identifier of `function` for the rig `node`.
pub(crate) fn id(function: u16, node: u8) -> u16 {
    function + u16::from(node & 0x7F)
}

/// The function in an identifier of the rig `node`; `None` where the identifier belongs to another node.
pub(super) fn function(id: u16, node: u8) -> Option<u16> {
    let own = id <= ID_MAX && id & !FUNCTION_MASK == u16::from(node);
    own.then_some(id & FUNCTION_MASK)
}

"""Power states of CiA 402 for drives on independent nodes."""

# Low byte of the statusword.
DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT = 0x50, 0x31, 0x33, 0x37, 0x17, 0x18
# Bits of its high byte: remote, target reached, and the bit specific to the mode.
REMOTE, REACHED, SPECIAL = 0x0200, 0x0400, 0x1000

HOMING, CSP = 6, 8


def next_power(power, word, before):
    """Power state after a controlword."""
    if power == FAULT:
        return DISABLED if word & 0x80 and not before & 0x80 else FAULT
    if not word & 0x02:
        return DISABLED
    if not word & 0x04:
        return QUICK_STOP if power in (ENABLED, QUICK_STOP) else DISABLED
    if not word & 0x01:
        return power if power == QUICK_STOP else READY
    if power == DISABLED:
        return DISABLED
    if not word & 0x08:
        return SWITCHED_ON if power in (READY, SWITCHED_ON, ENABLED) else power
    return {READY: SWITCHED_ON, SWITCHED_ON: ENABLED, QUICK_STOP: ENABLED}.get(power, power)


def status(power, mode, word, operational):
    """Statusword of a drive that reaches every set-point at once."""
    shown = power | (REMOTE if operational else 0)
    if power == ENABLED and (mode == CSP or mode == HOMING and word & 0x10):
        shown |= SPECIAL | (REACHED if mode == HOMING else 0)
    return shown

#!/usr/bin/env python3
"""Reference rig: the rig's side of "Rig protocol 1.0" on a pseudo-terminal, with a simple hydraulic plant.

Written from firmware-protocol.md alone; "s5" in a comment means section 5 of it. Standard library only.
The first line on stdout is the path of the pseudo-terminal. SIGTERM ends it. SIGUSR1 presses the emergency stop, SIGUSR2
releases it. Its author had the document and nothing else, so what it takes for granted the document says.
"""
import argparse
import binascii
import errno
import os
import random
import signal
import struct
import sys
import time
import tty
import zlib
from collections import deque

# --- codes (s2, s7, s8) -------------------------------------------------------------------------------------------
OFF, ARMED, RUNNING, HOLD, UNLOAD, TRIPPED = range(6)
STATE_NAMES = ("off", "armed", "running", "hold", "unload", "tripped")
BOOT_UP, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0x00, 0x04, 0x05, 0x7F
DONE, BUSY, WRONG_STATE, WRONG_CONFIGURATION, CAUSE_STANDS, UNKNOWN = 1, 2, 3, 4, 5, 6
DISPLACEMENT, FORCE = 1, 2
INVALID = -131072

# cause: (name, EMERGENCY code, register, state it leads to)
CAUSES = {
    0: ("none", 0x0000, 0x00, OFF), 1: ("lease_lapsed", 0x8130, 0x11, UNLOAD),
    2: ("host_abort", 0xFF02, 0x81, UNLOAD), 3: ("requested", 0xFF03, 0x81, UNLOAD),
    4: ("force_limit", 0xFF10, 0x81, UNLOAD), 5: ("displacement_limit", 0xFF11, 0x81, TRIPPED),
    6: ("velocity_limit", 0xFF12, 0x81, UNLOAD), 7: ("following_error", 0x8611, 0x81, UNLOAD),
    8: ("queue_dry", 0xFF20, 0x11, HOLD), 9: ("corrupt_frames", 0x8100, 0x11, UNLOAD),
    10: ("force_sensor", 0xFF30, 0x81, UNLOAD), 11: ("displacement_sensor", 0xFF31, 0x81, TRIPPED),
    12: ("sensor_stuck", 0xFF32, 0x81, TRIPPED), 13: ("specimen_break", 0xFF40, 0x81, TRIPPED),
    14: ("watchdog", 0x6010, 0x01, TRIPPED), 15: ("hold_timeout", 0xFF21, 0x81, UNLOAD),
    16: ("emergency_stop", 0x9000, 0x81, TRIPPED), 17: ("supply_pressure", 0xFF50, 0x81, TRIPPED),
    18: ("foreign_session", 0xFF22, 0x11, UNLOAD), 19: ("bad_command", 0xFF23, 0x11, HOLD),
}
(LEASE_LAPSED, HOST_ABORT, REQUESTED, FORCE_LIMIT, DISPLACEMENT_LIMIT, VELOCITY_LIMIT, FOLLOWING_ERROR, QUEUE_DRY,
 CORRUPT_FRAMES, FORCE_SENSOR, DISPLACEMENT_SENSOR, SENSOR_STUCK, SPECIMEN_BREAK, WATCHDOG, HOLD_TIMEOUT,
 EMERGENCY_STOP, SUPPLY_PRESSURE, FOREIGN_SESSION, BAD_COMMAND) = range(1, 20)

# s9: sub-index - 1: (lowest, highest, default)
LIMITS = (
    (-131071, 131071, 100000), (-131071, 131071, -5000), (-131071, 131071, 98000), (-131071, 131071, -98000),
    (1000, 2500000, 600000), (1, 40000, 2000), (1, 40000, 5000), (20, 500, 50), (100, 600000, 30000),
    (100, 50000, 10000), (5, 200, 30), (-131071, 131071, 100), (-131071, 131071, -10000),
)
(FORCE_MAX, FORCE_MIN, DISP_MAX, DISP_MIN, VELOCITY_MAX, FOLLOWING_D, FOLLOWING_F, LEASE_MS, HOLD_MS, UNLOAD_V,
 QUEUE_LOW, UNLOADED_FORCE, RETRACT) = range(13)
DECELERATION = 10.0  # 5 m/s2 = 10 displacement counts per ms, per ms

# --- checksums (s3) -----------------------------------------------------------------------------------------------
CRC8 = []
for _i in range(256):
    for _ in range(8):
        _i = (_i << 1) ^ 0x2F if _i & 0x80 else _i << 1
    CRC8.append(_i & 0xFF)
CRC8 = bytes(CRC8)


def crc8(data, crc=0xFF):
    for byte in data:
        crc = CRC8[crc ^ byte]
    return crc ^ 0xFF


def _wide_tables():
    """CRC-8 is linear: the share of each 16-bit word of bytes 2-3, 4-5, 6-7 of a frame, and of byte 1."""
    def share(distance):  # of one byte with `distance` bytes after it
        table = CRC8
        for _ in range(distance):
            table = bytes(CRC8[v] for v in table)
        return table
    words = [bytes(lo ^ hi for hi in share(2 * k) for lo in share(2 * k + 1)) for k in (2, 1, 0)]
    return (share(6), *words)


CRC_B1, CRC_W2, CRC_W4, CRC_W6 = _wide_tables()
HEAD = struct.Struct("<BBHHH")


class Crc8Of:
    """CRC-8 of one kind of frame whose CRC is in byte 0: four look-ups instead of nine steps (s3)."""

    def __init__(self, kind, node):
        self.start = crc8(bytes((node, kind)) + bytes(7))

    def __call__(self, frame):
        _, b1, w2, w4, w6 = HEAD.unpack(frame)
        return self.start ^ CRC_B1[b1] ^ CRC_W2[w2] ^ CRC_W4[w4] ^ CRC_W6[w6]


# --- serial packets (s4) ------------------------------------------------------------------------------------------
ONE = [bytes((i,)) for i in range(256)]


def packet(identifier, data):
    """COBS(identifier, data, CRC-16), then a zero. At most 12 bytes, so no COBS block is full."""
    raw = identifier.to_bytes(2, "little") + data
    raw += binascii.crc_hqx(raw, 0xFFFF).to_bytes(2, "little")  # crc_hqx is the polynomial 0x1021, not reflected
    return b"".join([ONE[len(s) + 1] + s for s in raw.split(b"\0")]) + b"\0"


def unpack(block):
    """Decode one COBS block (without its zero) to (identifier, data), or None if it is damaged."""
    raw, at, end = b"", 0, len(block)
    if end > 13:  # 2 + 8 + 2 bytes and one of COBS
        return None
    while at < end:
        code = block[at]
        if at + code > end:
            return None
        raw += block[at + 1:at + code]
        at += code
        if at < end:
            raw += b"\0"
    if len(raw) < 4 or raw[1] > 7 or binascii.crc_hqx(raw[:-2], 0xFFFF) != raw[-2] | raw[-1] << 8:
        return None
    return raw[0] | raw[1] << 8, raw[2:-2]


class Line:
    """The pseudo-terminal. What is sent while nobody has it open is lost, as on a real line."""

    def __init__(self, link_file):
        self.link_file = link_file
        self.fd = -1
        self.open()

    def open(self):
        self.fd, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self.fd, False)
        self.buffer, self.synchronised, self.unfinished, self.present, self.dropped = b"", False, True, False, 0
        if self.link_file:
            if os.path.islink(self.link_file):
                os.unlink(self.link_file)
            os.symlink(self.path, self.link_file)

    def close(self):
        if self.fd >= 0:
            os.close(self.fd)
        self.fd = -1
        if self.link_file and os.path.islink(self.link_file):
            os.unlink(self.link_file)

    def receive(self):
        """All whole packets that have come, decoded."""
        if self.fd < 0:
            return ()
        try:
            data = os.read(self.fd, 16384)
        except OSError as e:
            if e.errno == errno.EIO:  # nobody has the other end open
                self.present, self.synchronised, self.buffer = False, False, b""
            elif e.errno == errno.EAGAIN:
                self.present = True
            return ()
        self.present = True
        self.buffer += data
        *blocks, self.buffer = self.buffer.split(b"\0")
        if len(self.buffer) > 256:
            self.buffer = self.buffer[:257]  # stays too long, so it is dropped at the next zero
        frames = []
        for block in blocks:
            frame = unpack(block) if block else None
            if frame:
                frames.append(frame)
            elif block and self.synchronised:
                self.dropped += 1
            self.synchronised = True
        return frames

    def send(self, data):
        if not self.present or self.fd < 0:
            self.unfinished = True
            return
        if self.unfinished:
            data = b"\0" + data
        try:
            self.unfinished = os.write(self.fd, data) != len(data)
        except OSError:
            pass  # full: the newest sample wins, so this one is lost (s7)


# --- plant --------------------------------------------------------------------------------------------------------
class Plant:
    """First-order servo, pusher and a leaf spring with friction; mm, N, ms."""
    RATE, FRICTION, PRESLIDING, GAIN, LAG, V_MAX = 72.0, 0.15, 0.4, 60.0, 3.0, 250.0

    def __init__(self, seed):
        rng = random.Random(seed)
        self.noise_f = [rng.gauss(0, 0.5) for _ in range(4093)]
        self.noise_x = [rng.gauss(0, 0.001) for _ in range(4091)]
        self.x = self.v = self.z = 0.0
        self.rate = self.RATE
        self.n = 0
        self.force_open = self.disp_open = self.disp_stuck = self.stalled = False
        self.force_bias = self.disp_bias = 0.0
        self.last = 0

    def force(self):
        return self.rate * self.x * (1.0 + self.FRICTION * self.z) if self.x > 0.0 else 0.0

    def read(self):
        """Both channels in counts, nominal (s2)."""
        self.n += 1
        f = round((self.force() + self.force_bias + self.noise_f[self.n % 4093]) * 10.0)
        x = round((self.x + self.disp_bias + self.noise_x[self.n % 4091]) * 2000.0)
        if self.disp_stuck:
            x = self.last
        self.last = x
        return (INVALID if self.force_open or abs(f) > 131071 else f,
                INVALID if self.disp_open or abs(x) > 131071 else x)

    def step(self, asked):
        """One millisecond; `asked` is the speed that the servo asks of the valve, mm/s; None = valve blocked."""
        if asked is None or self.stalled:
            self.v = 0.0
            return
        self.v += (asked - self.v) / self.LAG
        dx = self.v * 0.001
        self.x += dx
        self.z += dx / self.PRESLIDING * (1.0 - self.z if dx > 0 else 1.0 + self.z)


class Sequence:
    """Counter check of one message (s3): 0 use, 1 repeated, 2 wrong sequence."""

    def __init__(self):
        self.used = self.suspect = None

    def check(self, counter):
        d = (counter - self.used) % 15 if self.used is not None else 1
        if d == 0:
            return 1
        if d > 4 and (self.suspect is None or (counter - self.suspect) % 15 != 1):
            self.suspect = counter
            return 2
        self.used, self.suspect = counter, None
        return 0


# --- the rig ------------------------------------------------------------------------------------------------------
class Rig:
    IDENTITY = {(0x1000, 0): 0, (0x1018, 1): 0x00000000, (0x1018, 2): 0x0001, (0x1018, 3): 0x00010000,
                (0x1018, 4): 1, (0x2000, 0): 0x00010000, (0x2002, 0): 1000, (0x2100, 0): 13}

    def __init__(self, options):
        self.options = options
        self.node = n = options.node
        self.crc_sample, self.crc_status = Crc8Of(0x51, n), Crc8Of(0x52, n)
        self.crc_command, self.crc_lease, self.crc_request = Crc8Of(0xA1, n), Crc8Of(0xA2, n), Crc8Of(0xA3, n)
        self.handlers = {0x000: (self.on_nmt, 2), 0x200 + n: (self.on_command, 8), 0x300 + n: (self.on_lease, 8),
                         0x400 + n: (self.on_request, 8), 0x600 + n: (self.on_config, 8)}
        self.plant = Plant(options.seed)
        self.line = Line(options.link_file)
        self.hash = options.calibration_hash
        self.boot_id = options.boot_id
        self.estop, self.supply = False, 1.0
        self.boot()

    def log(self, *text):
        if self.options.verbose:
            print(f"{time.strftime('%H:%M:%S')} tick {self.tick}:", *text, file=sys.stderr, flush=True)

    def boot(self, watchdog=False):
        """s6: off, or tripped with the emergency stop pressed; limits at their defaults; all checks start anew."""
        self.tick = 0
        self.out = []
        self.state, self.cause, self.nmt = OFF, 0, BOOT_UP
        self.limits = [default for _, _, default in LIMITS]
        self.session, self.lease_tick, self.control_tick = 0, 0, None
        self.last_request, self.ack_counter, self.ack_result = None, 15, 0
        self.command_sequence, self.lease_sequence = Sequence(), Sequence()
        self.sample_counter = self.status_counter = 0
        self.refused = self.dropped = self.foreign = 0
        self.corrupt_ticks, self.foreign_ticks = deque(maxlen=3), deque(maxlen=6)
        self.queue, self.newest, self.newest_last, self.motion_mode = {}, 0, False, None
        self.mode, self.set_point, self.speed = DISPLACEMENT, 0.0, 0.0
        self.force, self.disp = self.plant.read()
        self.start_counts()
        self.shown = None
        self.emit(0x700 + self.node, b"\0")  # boot-up, once
        self.nmt = PRE_OPERATIONAL
        if self.estop:
            self.fault(EMERGENCY_STOP)
        elif watchdog:
            self.fault(WATCHDOG)
        self.log("boot", self.boot_id)

    def start_counts(self):
        """s8: the counts of the criteria start anew when the pressure is switched on."""
        self.on_tick = self.tick
        self.n_disp_open = self.n_force_open = self.n_disp = self.n_force = self.n_supply = self.n_following = 0
        self.n_fast = self.n_unloaded = 0
        self.asked = deque([0.0] * 20, maxlen=20)
        self.n_same = 0
        self.f_history, self.x_history = deque(maxlen=12), deque(maxlen=12)
        self.corrupt_ticks.clear()
        self.foreign_ticks.clear()

    # --- sending
    def emit(self, identifier, data):
        self.out.append(packet(identifier, data))

    def send_sample(self):
        self.sample_counter = c = (self.sample_counter + 1) % 15
        frame = (c << 8 | (self.force & 0x3FFFF) << 12 | (self.disp & 0x3FFFF) << 30
                 | (self.tick & 0xFFFF) << 48).to_bytes(8, "little")
        frame = ONE[self.crc_sample(frame)] + frame[1:]
        self.emit(0x180 + self.node, frame)

    def queue_left(self):
        return max(0, min(255, self.newest - self.tick)) if self.queue else 0

    def send_status(self):
        if self.nmt == PRE_OPERATIONAL:
            return
        self.shown = (self.state, self.cause, self.session)
        self.status_counter = c = (self.status_counter + 1) % 15
        frame = struct.pack("<BBBBBBBB", 0, c | self.state << 4, self.cause, self.queue_left(), self.session,
                            self.ack_counter | self.ack_result << 4, self.boot_id & 0xFF, self.tick >> 16 & 0xFF)
        self.emit(0x280 + self.node, ONE[self.crc_status(frame)] + frame[1:])

    def send_emergency(self):
        _, code, register, _ = CAUSES[self.cause]
        body = struct.pack("<HBBBH", code, register, self.cause, self.state, self.tick & 0xFFFF)
        self.emit(0x080 + self.node, body + ONE[crc8(bytes((self.node, 0x53)) + body)])

    # --- states (s7)
    def pressure(self):
        return ARMED <= self.state <= UNLOAD

    def enter(self, state):
        self.log(STATE_NAMES[self.state], "->", STATE_NAMES[state], CAUSES[self.cause][0])
        if state in (HOLD, UNLOAD) and self.state in (ARMED, RUNNING, HOLD) and self.mode == FORCE:
            self.mode = DISPLACEMENT  # no displacement set point in force control: take the feedback and its speed
            self.set_point = float(self.valid_disp)
            self.speed = (self.x_history[-1] - self.x_history[0]) / max(1, len(self.x_history) - 1)
        if state not in (ARMED, RUNNING):
            self.clear_queue()
        if state == HOLD:
            self.hold_tick = self.tick
        elif state == UNLOAD:
            self.unload_tick, self.n_unloaded, self.n_following = self.tick, 0, 0
        elif state in (OFF, TRIPPED):
            self.speed = 0.0
        self.state = state

    def clear_queue(self):
        self.queue.clear()
        self.newest, self.newest_last, self.motion_mode = self.tick, False, None

    def keep_feedback(self):
        """Set point = feedback, in displacement control."""
        self.mode, self.set_point, self.speed = DISPLACEMENT, float(self.valid_disp), 0.0

    def fault(self, cause, leads_to=None):
        """s7: the first cause is kept; a milder reaction changes nothing; EMERGENCY once for each latched cause."""
        leads_to = leads_to or CAUSES[cause][3]
        latch = self.cause in (0, REQUESTED) and self.state <= leads_to
        if latch:
            self.cause = cause
        if leads_to > self.state:
            self.enter(leads_to)
        if latch:
            self.log("cause", CAUSES[cause][0])
            self.send_emergency()

    def refuse(self):
        """s3, s7: CRC-8, reserved bit, unknown value, wrong sequence; the third within 100 ms unloads."""
        self.refused += 1
        ticks = self.corrupt_ticks
        ticks.append(self.tick)
        if self.pressure() and len(ticks) == 3 and self.tick - ticks[0] < 100:
            self.fault(CORRUPT_FRAMES)

    def stranger(self):
        """s5: LEASE or COMMAND of another session; the sixth within 100 ms unloads."""
        self.foreign += 1
        ticks = self.foreign_ticks
        ticks.append(self.tick)
        if self.pressure() and len(ticks) == 6 and self.tick - ticks[0] < 100:
            self.fault(FOREIGN_SESSION)

    # --- receiving (s2)
    def on_nmt(self, data):
        command, node = data
        if node not in (0, self.node):
            return
        if command == 0x01:
            self.nmt = OPERATIONAL
            self.log("NMT start")
        elif command == 0x02:
            self.nmt = STOPPED
            self.log("NMT stop")
            if self.pressure() and (self.state != UNLOAD or self.cause == REQUESTED):
                self.fault(HOST_ABORT)
            self.send_status()
        elif command == 0x80:
            if not self.pressure():
                self.nmt = PRE_OPERATIONAL
        elif command == 0x81:
            if not self.pressure():
                self.boot_id = self.boot_id + 1 & 0xFFFFFFFF
                self.boot()
        else:
            self.refuse()

    def on_command(self, data):
        v = int.from_bytes(data, "little")
        session, mode, counter = v >> 16 & 0xFF, v >> 12 & 3, v >> 8 & 15
        counts = ((v >> 24 & 0x3FFFF) ^ 0x20000) - 0x20000
        if (self.crc_command(data) != data[0] or v & 0xFC0000008000 or mode in (0, 3) or session == 0
                or counter == 15 or counts == INVALID):
            return self.refuse()
        if session != self.session:
            return self.stranger() if self.session else None
        verdict = self.command_sequence.check(counter)
        if verdict:
            return self.refuse() if verdict == 2 else None
        if self.state not in (ARMED, RUNNING):
            self.dropped += 1
            return
        # s7: mode and limits are checked before the tick
        low, high = ((self.limits[DISP_MIN], self.limits[DISP_MAX]) if mode == DISPLACEMENT
                     else (self.limits[FORCE_MIN], self.limits[FORCE_MAX]))
        if self.motion_mode not in (None, mode) or not low <= counts <= high:
            return self.fault(BAD_COMMAND)
        ahead = (((v >> 48) - self.tick & 0xFFFF) ^ 0x8000) - 0x8000
        if not 0 < ahead <= 250:
            self.dropped += 1
            return
        due = self.tick + ahead
        if not self.queue or due >= self.newest:
            self.newest, self.newest_last = due, bool(v & 0x4000)
        self.queue[due] = counts
        self.motion_mode = mode

    def on_lease(self, data):
        v = int.from_bytes(data, "little")
        session, counter, tick = v >> 16 & 0xFF, v >> 8 & 15, v >> 48
        if self.crc_lease(data) != data[0] or v & 0xFFFFFF00F000 or session == 0 or counter == 15:
            return self.refuse()
        if session != self.session:
            return self.stranger() if self.session else None
        verdict = self.lease_sequence.check(counter)
        if verdict:
            return self.refuse() if verdict == 2 else None
        if self.control_tick is None or 0 < (tick - self.control_tick & 0xFFFF) < 0x8000:  # s5: newer
            self.control_tick, self.lease_tick = tick, self.tick

    def on_request(self, data):
        counter, session, code, argument = data[1], data[2], data[3], int.from_bytes(data[4:], "little")
        if self.crc_request(data) != data[0] or counter > 14 or session == 0:
            return self.refuse()
        if data != self.last_request:  # a repeat is answered again, not carried out again
            self.last_request = data
            self.ack_counter, self.ack_result = counter, self.carry_out(session, code, argument)
            self.log("request", code, "of", session, "result", self.ack_result)
        self.send_status()

    def cause_stands(self):
        return (INVALID in (self.force, self.disp) or self.estop
                or not self.limits[DISP_MIN] <= self.disp <= self.limits[DISP_MAX])

    def carry_out(self, session, code, argument):
        if code == 1:  # open_session
            if self.session not in (0, session):
                return BUSY
            self.session, self.lease_tick, self.control_tick = session, self.tick, None
            self.command_sequence, self.lease_sequence = Sequence(), Sequence()
            return DONE
        if not 1 <= code <= 7:
            return UNKNOWN
        if session != self.session:
            return BUSY
        state, limits = self.state, self.limits
        if code == 2:  # arm
            if state != OFF or self.nmt == STOPPED:
                return WRONG_STATE
            if (argument != self.limits_crc() or not limits[FORCE_MIN] <= limits[UNLOADED_FORCE] < limits[FORCE_MAX]
                    or not limits[DISP_MIN] <= limits[RETRACT] < limits[DISP_MAX]):
                return WRONG_CONFIGURATION
            if self.cause_stands():
                return CAUSE_STANDS
            self.cause, self.valid_disp, self.valid_force = 0, self.disp, self.force
            self.enter(ARMED)
            self.clear_queue()
            self.keep_feedback()
            self.start_counts()
        elif code == 3:  # hold
            if state not in (ARMED, RUNNING, HOLD):
                return WRONG_STATE
            if state != HOLD:
                self.enter(HOLD)
        elif code == 4:  # resume
            if state != HOLD:
                return WRONG_STATE
            self.cause = 0
            self.enter(ARMED)
            self.keep_feedback()
        elif code == 5:  # unload
            if state == TRIPPED:
                return WRONG_STATE
            if state in (ARMED, RUNNING, HOLD):
                if self.cause == 0:
                    self.cause = REQUESTED
                self.enter(UNLOAD)
        elif code == 6:  # reset
            if state != TRIPPED:
                return WRONG_STATE
            if self.cause_stands():
                return CAUSE_STANDS
            self.cause = 0
            self.enter(OFF)
        else:  # clear_queue
            if state not in (ARMED, HOLD):
                return WRONG_STATE
            self.clear_queue()
            self.keep_feedback()
        return DONE

    # --- objects (s9)
    def limits_crc(self):
        return zlib.crc32(struct.pack("<13i", *self.limits))

    def on_config(self, data):
        command, index, sub, value = struct.unpack("<BHBI", data)
        if command == 0x80:
            return
        answer, result = self.config(command, index, sub, value)
        self.emit(0x580 + self.node, struct.pack("<BHBI", answer, index, sub, result & 0xFFFFFFFF))

    def config(self, command, index, sub, value):
        if command not in (0x40, 0x23) or command == 0x40 and value:
            return 0x80, 0x05040001
        objects = {**self.IDENTITY, (0x2001, 0): self.boot_id, (0x2003, 0): self.hash, (0x2004, 0): self.limits_crc(),
                   (0x2005, 1): self.refused, (0x2005, 2): self.dropped, (0x2005, 3): self.foreign}
        objects.update({(0x2100, i + 1): limit for i, limit in enumerate(self.limits)})
        if (index, sub) not in objects:
            return 0x80, 0x06090011 if index in {i for i, _ in objects} else 0x06020000
        if command == 0x40:
            return 0x43, objects[index, sub]
        if index == 0x2100 and sub:
            if self.state not in (OFF, TRIPPED):
                return 0x80, 0x08000022
            value = (value ^ 0x80000000) - 0x80000000
            low, high, _ = LIMITS[sub - 1]
            if not low <= value <= high:
                return 0x80, 0x06090030
            self.limits[sub - 1] = value
        elif index == 0x2003:
            if self.state != OFF:
                return 0x80, 0x08000022
            self.hash = value
        else:
            return 0x80, 0x06010002
        return 0x60, 0

    # --- one millisecond
    def criteria(self):
        """s8, in the order of its table; returns the first cause or 0. Runs with the pressure on only."""
        force_ok, disp_ok = self.force != INVALID, self.disp != INVALID
        x_before = self.valid_disp
        if force_ok:
            self.valid_force = self.force
        if disp_ok:
            self.valid_disp = self.disp
        f, x, limits = self.valid_force, self.valid_disp, self.limits
        fs, xs = self.f_history, self.x_history
        fs.append(f)
        xs.append(x)
        self.n_supply = self.n_supply + 1 if self.supply < 0.8 and self.tick - self.on_tick >= 300 else 0
        self.n_disp_open = 0 if disp_ok else self.n_disp_open + 1
        self.n_force_open = 0 if force_ok else self.n_force_open + 1
        self.n_same = self.n_same + 1 if disp_ok and len(xs) > 1 and x == x_before else 0
        self.n_disp = self.n_disp + 1 if not limits[DISP_MIN] <= x <= limits[DISP_MAX] else 0
        self.n_force = self.n_force + 1 if not limits[FORCE_MIN] <= f <= limits[FORCE_MAX] else 0
        step = x - x_before if len(xs) > 1 else 0
        if abs(step) * 1000 <= limits[VELOCITY_MAX]:
            self.n_fast = 0
        elif step > 0:
            self.n_fast = max(self.n_fast, 0) + 1
        else:
            self.n_fast = min(self.n_fast, 0) - 1
        feedback, allowed = (x, limits[FOLLOWING_D]) if self.mode == DISPLACEMENT else (f, limits[FOLLOWING_F])
        beyond = abs(self.set_point - feedback) > allowed + abs(self.speed) * 20
        self.n_following = self.n_following + 1 if beyond else 0
        if self.estop:
            return EMERGENCY_STOP
        if self.n_supply >= 5:
            return SUPPLY_PRESSURE
        if self.n_disp_open >= 2:
            return DISPLACEMENT_SENSOR
        if self.n_same >= 20 and abs(sum(self.asked)) * 0.001 > 0.5:
            return SENSOR_STUCK
        if self.n_disp >= 2:
            return DISPLACEMENT_LIMIT
        if len(fs) == 12 and force_ok:
            before, now = min(fs[0], fs[1]) / 10, max(fs[10], fs[11]) / 10
            fell = before - now
            if fell > 0.5 * before and fell > 200 and fell > 1000 * (xs[0] - x) * 0.0005:
                return SPECIMEN_BREAK
        if self.n_force_open >= 2:
            return FORCE_SENSOR
        if self.n_force >= 2:
            return FORCE_LIMIT
        if abs(self.n_fast) >= 3:
            return VELOCITY_LIMIT
        return FOLLOWING_ERROR if self.n_following >= 20 else 0

    def follow_queue(self):
        """s7, the command queue: one slot per tick, gaps are interpolated, dry is a hold."""
        tick, queue = self.tick, self.queue
        if self.state == ARMED:
            if tick not in queue:
                return
            self.mode = self.motion_mode
            self.set_point = self.valid_disp if self.mode == DISPLACEMENT else self.valid_force
            self.enter(RUNNING)
            before = queue[tick]
        else:
            before = self.set_point
        if tick in queue:
            self.set_point = queue.pop(tick)
        else:
            due = min(queue)
            self.set_point = before + (queue[due] - before) / (due - tick + 1)
        self.speed = self.set_point - before
        if self.newest_last:
            if self.newest <= tick:
                self.enter(ARMED)
        elif self.newest - tick < self.limits[QUEUE_LOW]:
            self.fault(QUEUE_DRY)

    def guide(self):
        """The set point in hold and unload (s7)."""
        wanted = 0.0 if self.state == HOLD else -self.limits[UNLOAD_V] / 1000
        self.speed += max(-DECELERATION, min(DECELERATION, wanted - self.speed))
        self.set_point += self.speed
        if self.state == HOLD:
            if self.tick - self.hold_tick >= self.limits[HOLD_MS]:
                self.fault(HOLD_TIMEOUT)
            return
        self.set_point = max(self.limits[DISP_MIN], min(self.limits[DISP_MAX], self.set_point))
        unloaded = self.force != INVALID and self.force <= self.limits[UNLOADED_FORCE]
        self.n_unloaded = self.n_unloaded + 1 if unloaded else 0
        retracted = self.disp != INVALID and self.disp <= self.limits[RETRACT]
        if self.speed == wanted and (self.n_unloaded >= 5 or retracted):
            requested = self.cause == REQUESTED
            if requested:
                self.cause = 0
            self.enter(OFF if requested else TRIPPED)
        elif self.tick - self.unload_tick > 60000:
            self.fault(FOLLOWING_ERROR, TRIPPED)

    def servo(self):
        """Asks a speed of the valve; None while the blocking valve is closed."""
        if not self.pressure():
            return None
        error = ((self.set_point - self.valid_disp) * 0.0005 if self.mode == DISPLACEMENT
                 else (self.set_point - self.valid_force) * 0.1 / Plant.RATE)
        asked = max(-Plant.V_MAX, min(Plant.V_MAX, Plant.GAIN * error))
        self.asked.append(asked)
        return asked

    def run_tick(self):
        for identifier, data in self.line.receive():
            handler = self.handlers.get(identifier)
            if handler and len(data) == handler[1] and (
                    self.nmt != PRE_OPERATIONAL or identifier == 0 or identifier >= 0x600):
                handler[0](data)
        self.tick += 1
        tick = self.tick
        self.force, self.disp = self.plant.read()
        if self.session and tick - self.lease_tick >= self.limits[LEASE_MS]:  # s5
            self.session = 0
            self.log("lease lapsed")
            if self.pressure():
                self.fault(LEASE_LAPSED)
        if self.pressure():
            cause = self.criteria()
            if cause:
                self.fault(cause, TRIPPED if self.state == UNLOAD and cause == FOLLOWING_ERROR else None)
            if self.state in (ARMED, RUNNING):
                self.follow_queue()
            elif self.pressure():
                self.guide()
        elif self.estop:
            self.fault(EMERGENCY_STOP)
        self.plant.step(self.servo())
        if self.nmt != PRE_OPERATIONAL:
            self.send_sample()
            if tick % 10 == 0 or self.shown != (self.state, self.cause, self.session):
                self.send_status()
        if tick % 100 == 0:
            self.emit(0x700 + self.node, ONE[self.nmt])
        if self.out:
            data, self.out = b"".join(self.out), []
            self.line.send(data)


def main(rig_class=Rig, add_options=None):
    number = lambda text: int(text, 0)
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--node", type=number, default=1)
    p.add_argument("--calibration-hash", type=number, default=0)
    p.add_argument("--boot-id", type=number, default=random.getrandbits(32))
    p.add_argument("--seed", type=number, default=1)
    p.add_argument("--link-file", help="also write a symlink to the pseudo-terminal")
    p.add_argument("--watchdog-ms", type=number, default=0, help="trip when the loop was away for so long; the document "
                   "says 10, which a busy machine cannot keep; 0 = off")
    p.add_argument("--verbose", action="store_true", help="states and requests on stderr")
    if add_options:
        add_options(p)
    options = p.parse_args()
    stop = []
    signal.signal(signal.SIGTERM, lambda *_: stop.append(1))
    signal.signal(signal.SIGINT, lambda *_: stop.append(1))
    rig = rig_class(options)
    signal.signal(signal.SIGUSR1, lambda *_: setattr(rig, "estop", True))
    signal.signal(signal.SIGUSR2, lambda *_: setattr(rig, "estop", False))
    print(rig.line.path, flush=True)
    period, clock = 1_000_000, time.monotonic_ns
    due, burst = clock(), 0
    try:
        while not stop:
            rig.run_tick()
            due += period
            burst += 1
            late = clock() - due
            if late < 0:
                time.sleep(-late * 1e-9)
                burst = 0
            else:
                if options.watchdog_ms and late > options.watchdog_ms * period and rig.pressure():
                    rig.fault(WATCHDOG)
                if late > 1000 * period:  # hopeless: the tick falls behind the clock
                    due += late
                if burst >= 3:  # never more than three ticks at once; the clock is kept in the long run
                    time.sleep(0.0003)
                    burst = 0
    finally:
        rig.line.close()


if __name__ == "__main__":
    main()

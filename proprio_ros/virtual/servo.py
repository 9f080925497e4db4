"""One emulated servo: its control table, its current controller, and what makes it stop.

Behaviour: ROBOTIS e-manual, XM430-W350, "Control Table Description" and "Protocol 2.0". Where the manual says nothing, the
comment says "assumed". Left out: profiles, feedforward, the integral gain of the position controller, multi-turn reset,
indirect addresses, backup.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from types import MappingProxyType

from proprio_ros.bus import control_table
from proprio_ros.virtual.protocol import ALERT, Error

# period of the current controller: `VirtualServo.control` is called once per period [s]
CONTROL_PERIOD_S = 0.001
REBOOT_S = 0.3  # time without an answer after a reboot; assumed [s]
AMBIENT_C = 30.0

_GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")
_REVERSE = 0x01  # bit of Drive Mode
_TICK_WRAP = 32768  # Realtime Tick counts 0..32767 ms

# assumed: the manual gives no controller periods, averages, thermal data or times
_VELOCITY_AVERAGE = 8  # periods
_THERMAL_RESISTANCE_K_W = 4.0
_THERMAL_TIME_S = 300.0
_OVERLOAD_FRACTION = 0.9
_OVERLOAD_S = 5.0
# divisors of the velocity controller's gains, and what one count of its output means; assumed: current
_VELOCITY_P_DIVISOR = 128.0
_VELOCITY_I_DIVISOR = 65536.0

# as plain numbers: looked at by each servo in each period
_MODE = control_table.OperatingMode
_CURRENT = int(_MODE.CURRENT)
_VELOCITY = int(_MODE.VELOCITY)
_PWM = int(_MODE.PWM)
_CURRENT_BASED_POSITION = int(_MODE.CURRENT_BASED_POSITION)

Goals = Mapping[str, int]


class VirtualServo:
    """A servo that obeys its control table.

    Angles, velocities and currents are those of the shaft in the servo's own direction; the plant behind it calls
    `control` once per period and lets the returned current flow. ``servo["current_limit"]`` reads or sets a register
    without the bus's rules, as the factory does.

    Attributes:
        model: Control table and units.
        supply_voltage_V: May be changed at any time.
        temperature_C: Of the motor; heated by the current, may be set.
        latency_s: From a written goal to its effect.
    """

    def __init__(
        self,
        model: control_table.ServoModel,
        servo_id: int,
        *,
        firmware: int = 46,
        supply_voltage_V: float = 12.0,
        back_emf_V_s_per_rad: float = 2.49,
        resistance_ohm: float = 5.22,
        latency_s: float = 0.0,
        control_period_s: float = CONTROL_PERIOD_S,
    ) -> None:
        self.model = model
        self._period_s = control_period_s
        self._warming = control_period_s / _THERMAL_TIME_S
        self.supply_voltage_V = supply_voltage_V
        self.temperature_C = AMBIENT_C
        self.latency_s = latency_s
        self._highest_pwm = model.registers["pwm_limit"].highest
        self._back_emf_V_s_per_rad = back_emf_V_s_per_rad
        self._resistance_ohm = resistance_ohm
        self._registers = model.registers
        places = {name: range(register.size) for name, register in self._registers.items()}
        self._bytes = {
            self._registers[name].address + k: (name, k)
            for name, sizes in places.items()
            for k in sizes
        }
        self._end = max(self._bytes) + 1
        self._values = {name: register.initial for name, register in self._registers.items()}
        self._values.update(
            model_number=model.number,
            firmware_version=firmware,
            id=servo_id,
        )
        self._booted_s = 0.0
        self._silent_until_s = -math.inf
        self._heard_s = 0.0
        self._velocities: deque[float] = deque(maxlen=_VELOCITY_AVERAGE)
        # supply at which `_tune` was called last; not a number: a register has changed since
        self._tuned_V = math.nan
        self._controlled_s = 0.0
        self._felt_C = AMBIENT_C
        self._powered = False
        self._unread = False  # whether there are measurements that no register holds yet
        self._goals: Goals | None
        self._pending: deque[tuple[float, Goals]]
        self._overloaded_s = 0.0
        self._reset_mode()

    def __getitem__(self, name: str) -> int:
        if self._unread:
            self._measure()
        return self._values[name]

    def __setitem__(self, name: str, value: int) -> None:
        register = self._registers[name]
        self._values[name] = register.decode(register.encode(value))
        self._tuned_V = math.nan

    @property
    def id(self) -> int:
        return self._values["id"]

    @property
    def baud(self) -> int:
        """Bits per second that it understands."""
        return control_table.BAUD_RATES[self._values["baud_rate"]]

    @property
    def return_delay_s(self) -> float:
        return self._values["return_delay_time"] * control_table.RETURN_DELAY_UNIT_S

    def awake(self, now_s: float) -> bool:
        """Whether it hears and answers; not while it boots."""
        return now_s >= self._silent_until_s

    def heard(self, now_s: float) -> None:
        """An instruction packet passed on the bus, whomever it was for: the bus watchdog starts anew."""
        self._heard_s = now_s

    def status_error(self, error: int) -> int:
        """Error byte of a status packet: the alert bit comes on top while there is a hardware error."""
        return error | (ALERT if self._values["hardware_error_status"] else 0)

    def read(self, address: int, length: int) -> tuple[Error, bytes]:
        """Bytes of the control table; addresses between the registers read as 0.

        Returns: `Error.DATA_RANGE` and no bytes beyond the end of the table; else `Error.NONE` and ``length`` bytes.
        """
        if length < 1 or address + length > self._end:
            return Error.DATA_RANGE, b""
        if self._unread:
            self._measure()
        found = bytearray()
        while len(found) < length:
            name, index = self._bytes.get(
                address + len(found),
                ("", 0),
            )
            found += self._registers[name].encode(self._values[name])[index:] if name else b"\0"
        return Error.NONE, bytes(found[:length])

    def write(self, address: int, data: bytes, now_s: float) -> Error:
        """Set whole registers; with an error nothing is set (assumed).

        Args:
            address: Of the first register.
            data: Bytes of the registers.
            now_s: The time [s].

        Returns:
            The error that the servo answers with.
        """
        values, error = self._parsed(address, data)
        if error:
            return error
        for name, value in values.items():
            self._set(name, value, now_s)
        if any(name in _GOALS for name in values):
            self._pending.append((now_s + self.latency_s, self._written_goals()))
        return Error.NONE

    def reboot(self, now_s: float) -> None:
        """Power off and on: RAM and errors go, EEPROM stays, and it is silent for `REBOOT_S`."""
        for name, register in self._registers.items():
            if not register.eeprom:
                self._values[name] = register.initial
        self._unread = False
        self._tuned_V = math.nan
        self._booted_s = now_s
        self._silent_until_s = now_s + REBOOT_S
        self._overloaded_s = 0.0
        self._reset_mode()

    def _parsed(
        self,
        address: int,
        data: bytes,
    ) -> tuple[dict[str, int], Error]:
        """Registers that a write means, and why it is refused."""
        values: dict[str, int] = {}
        position = address
        end = address + len(data)
        while position < end:
            name, index = self._bytes.get(position, ("", 0))
            if not name or index:
                return {}, Error.ACCESS  # in the middle of a register, or not defined
            register = self._registers[name]
            if position + register.size > end:
                return {}, Error.DATA_LENGTH
            values[name] = register.decode(
                data[position - address : position - address + register.size]
            )
            position += register.size
        if not values:
            return {}, Error.DATA_LENGTH
        error = next(
            filter(None, (self._refusal(name, value) for name, value in values.items())), Error.NONE
        )
        return ({} if error else values), error

    def _refusal(self, name: str, value: int) -> Error:
        register = self._registers[name]
        if not register.writable or (register.eeprom and self._values["torque_enable"]):
            return Error.ACCESS
        tripped = self._values["bus_watchdog"] == control_table.BUS_WATCHDOG_TRIPPED
        if tripped and (name in _GOALS or (name == "bus_watchdog" and value != 0)):
            return Error.DATA_RANGE
        if not register.lowest <= value <= register.highest or (
            name == "operating_mode" and value not in set(_MODE)
        ):
            return Error.DATA_RANGE
        if register.limit is not None and abs(value) > self._values[register.limit]:
            return Error.DATA_LIMIT
        if name == "goal_position" and self._values["operating_mode"] == _MODE.POSITION:
            if (
                not self._values["min_position_limit"]
                <= value
                <= self._values["max_position_limit"]
            ):
                return Error.DATA_LIMIT
        if name == "torque_enable" and value and self._shut_down:
            return Error.RESULT_FAIL  # assumed: the manual only says that a reboot is needed
        return Error.NONE

    def _set(self, name: str, value: int, now_s: float) -> None:
        before = self._values[name]
        self._values[name] = value
        if name not in _GOALS:
            self._tuned_V = math.nan
        if name == "operating_mode" and value != before:
            self._reset_mode()
        elif name == "torque_enable":
            if value and not before:
                self._start(now_s)
            elif not value:
                self._stop()
        elif name == "bus_watchdog":
            self._heard_s = now_s

    @property
    def _shut_down(self) -> bool:
        return bool(self._values["hardware_error_status"] & self._values["shutdown"])

    def _written_goals(self) -> Goals:
        return MappingProxyType({name: self._values[name] for name in _GOALS})

    def _reset_mode(self) -> None:
        """A new mode starts from its own first values; assumed: the same gains for all modes, and no profile."""
        for name, register in self._registers.items():
            if name.endswith("_gain") or name.startswith("profile_"):
                self._values[name] = register.initial
        self._reset_goals()

    def _reset_goals(self) -> None:
        """Goals that ask for nothing, and bounds that allow everything."""
        mode = self._values["operating_mode"]
        self._values["goal_velocity"] = 0
        self._values["goal_pwm"] = 0 if mode == _MODE.PWM else self._values["pwm_limit"]
        self._values["goal_current"] = 0 if mode == _MODE.CURRENT else self._values["current_limit"]
        self._values["goal_position"] = self._values["present_position"]
        self._stop()

    def _start(self, now_s: float) -> None:
        """Torque on: stay where it is."""
        self._reset_goals()
        self._goals = self._written_goals()
        self._heard_s = now_s

    def _stop(self) -> None:
        """No current until new goals arrive."""
        self._goals = None
        self._pending = deque()
        self._velocity_integral = 0.0

    def fail(self, error: control_table.HardwareError) -> None:
        """Report a hardware error; torque goes off when the register Shutdown says so."""
        self._values["hardware_error_status"] |= 1 << error
        if self._shut_down:
            self._values["torque_enable"] = 0
            self._stop()

    def control(self, now_s: float, angle_rad: float, velocity_rad_s: float) -> float:
        """One period of the controller: measure, look for trouble, choose the current that flows until the next call.

        Args:
            now_s: The time, a period after the last call [s].
            angle_rad: Of the shaft [rad].
            velocity_rad_s: Of the shaft [rad/s].

        Returns:
            The current, a whole number of counts [A].
        """
        if self._tuned_V != self.supply_voltage_V:
            self._tune()
        values = self._values
        sign = self._sign
        velocity_rad_s *= sign
        self._velocities.append(velocity_rad_s)
        values["present_position"] = self._zero_counts + round(
            sign * angle_rad / self.model.position_unit_rad
        )
        self._controlled_s = now_s
        self._felt_C = self.temperature_C
        if (
            self._ailing
            or self._felt_C > self._hot_C
            or abs(values["present_current"]) >= self._straining_counts
        ):
            self._look_for_trouble()
        else:
            self._overloaded_s = 0.0
        if values["bus_watchdog"] > 0 and values["torque_enable"]:
            if now_s - self._heard_s > values["bus_watchdog"] * control_table.BUS_WATCHDOG_UNIT_S:
                values["bus_watchdog"] = control_table.BUS_WATCHDOG_TRIPPED
                # the manual's example gives a new goal after the error is cleared: the old one is gone
                self._stop()
        while self._pending and self._pending[0][0] <= now_s:
            self._goals = self._pending.popleft()[1]
        self._powered = (
            bool(values["torque_enable"])
            and self._goals is not None
            and now_s >= self._silent_until_s
        )
        counts = 0
        if self._powered and values["bus_watchdog"] != control_table.BUS_WATCHDOG_TRIPPED:
            counts = self._bounded(self._wanted(velocity_rad_s), velocity_rad_s)
        values["present_current"] = counts
        self._unread = True
        current_A = counts * self.model.current_unit_A
        # heat of the winding into one thermal mass; assumed values
        final_C = AMBIENT_C + _THERMAL_RESISTANCE_K_W * self._resistance_ohm * (
            current_A * current_A
        )
        self.temperature_C += (final_C - self.temperature_C) * self._warming
        return sign * current_A

    def _tune(self) -> None:
        """What follows from registers and from the supply, and is needed in each period."""
        values = self._values
        model = self.model
        self._tuned_V = self.supply_voltage_V
        self._sign = -1.0 if values["drive_mode"] & _REVERSE else 1.0
        self._zero_counts = model.position_zero + values["homing_offset"]
        self._p_gain = values["position_p_gain"] / model.position_p_divisor
        self._d_gain = values["position_d_gain"] / model.position_d_divisor
        self._volt_per_pwm = max(self.supply_voltage_V, 1e-3) / self._highest_pwm
        self._pwm_limit_V = values["pwm_limit"] * self._volt_per_pwm
        voltage = values["present_input_voltage"] = max(
            0, round(self.supply_voltage_V / model.voltage_unit_V)
        )
        self._ailing = not values["min_voltage_limit"] <= voltage <= values["max_voltage_limit"]
        self._hot_C = values["temperature_limit"] - 1.0
        # assumed: overload is nearly the highest possible current without motion for some seconds
        highest_A = min(
            model.current_A(values["current_limit"]), self._current_at_A(self.supply_voltage_V, 0.0)
        )
        self._straining_counts = max(_OVERLOAD_FRACTION * highest_A / model.current_unit_A, 1.0)

    def _measure(self) -> None:
        """Registers on which nothing in a period depends, as they were in the last one."""
        self._unread = False
        values = self._values
        velocities = self._velocities
        model = self.model
        speed = round(sum(velocities) / len(velocities) / model.velocity_unit_rad_s)
        values["present_velocity"] = speed
        values["moving"] = 1 if abs(speed) > values["moving_threshold"] else 0
        # the small addition keeps a sum of milliseconds from being rounded down
        values["realtime_tick"] = (
            int((self._controlled_s - self._booted_s) * 1e3 + 1e-6) % _TICK_WRAP
        )
        values["present_temperature"] = min(255, max(0, round(self._felt_C)))
        current_A = model.current_A(values["present_current"])
        back_V = self._back_emf_V_s_per_rad * velocities[-1]
        pwm = (
            round((self._resistance_ohm * current_A + back_V) / self._volt_per_pwm)
            if self._powered
            else 0
        )
        values["present_pwm"] = max(-32768, min(32767, pwm))  # what its bytes hold

    def _wanted(self, velocity_rad_s: float) -> float:
        """Current before any bound [counts]."""
        assert self._goals is not None
        goals = self._goals
        values = self._values
        model = self.model
        mode = values["operating_mode"]
        if mode == _CURRENT:
            return goals["goal_current"]
        if mode == _VELOCITY:
            error = goals["goal_velocity"] - velocity_rad_s / model.velocity_unit_rad_s
            self._velocity_integral += error * values["velocity_i_gain"] / _VELOCITY_I_DIVISOR
            self._velocity_integral = _clip(self._velocity_integral, values["current_limit"])
            return error * values["velocity_p_gain"] / _VELOCITY_P_DIVISOR + self._velocity_integral
        if mode == _PWM:
            return self._current_of_pwm(goals["goal_pwm"], velocity_rad_s)
        wanted = (goals["goal_position"] - values["present_position"]) * self._p_gain
        wanted -= velocity_rad_s / model.position_unit_rad * 1e-3 * self._d_gain
        if mode == _CURRENT_BASED_POSITION:
            return _clip(wanted, abs(goals["goal_current"]))
        return self._current_of_pwm(_clip(wanted, abs(goals["goal_pwm"])), velocity_rad_s)

    def _current_of_pwm(self, pwm: float, velocity_rad_s: float) -> float:
        voltage_V = _clip(pwm, self._values["pwm_limit"]) * self._volt_per_pwm
        return self._current_at_A(voltage_V, velocity_rad_s) / self.model.current_unit_A

    def _current_at_A(self, voltage_V: float, velocity_rad_s: float) -> float:
        """Steady current; the inductance settles well within a period."""
        return (voltage_V - self._back_emf_V_s_per_rad * velocity_rad_s) / self._resistance_ohm

    def _bounded(self, wanted: float, velocity_rad_s: float) -> int:
        """Whole counts within Current Limit, and within what the supply can drive at this speed."""
        unit_A = self.model.current_unit_A
        back_V = self._back_emf_V_s_per_rad * velocity_rad_s
        counts = round(_clip(wanted, self._values["current_limit"]))
        if counts > (highest := (self._pwm_limit_V - back_V) / self._resistance_ohm / unit_A):
            counts = math.floor(highest)
        if counts < (lowest := (-self._pwm_limit_V - back_V) / self._resistance_ohm / unit_A):
            counts = math.ceil(lowest)
        return counts

    def _look_for_trouble(self) -> None:
        """What makes it fail, where that is near."""
        self._measure()
        values = self._values
        if self._ailing:
            self.fail(control_table.HardwareError.INPUT_VOLTAGE)
        if values["present_temperature"] > values["temperature_limit"]:
            self.fail(control_table.HardwareError.OVERHEATING)
        straining = (
            abs(values["present_current"]) >= self._straining_counts and not values["moving"]
        )
        self._overloaded_s = self._overloaded_s + self._period_s if straining else 0.0
        if self._overloaded_s > _OVERLOAD_S:
            self.fail(control_table.HardwareError.OVERLOAD)


def _clip(value: float, bound: float) -> float:
    return bound if value > bound else -bound if value < -bound else value

"""What each room makes of a sensor that only the table knows. Run in a process of its own: rooms read it on import."""

import json

import numpy as np

from mufly.quantities import sensor_table

ROW = sensor_table.ReadingRow(
    name="airspeed", unit="m/s", dim="body", meaning="made-up speed of the air",
    variance=("m^2/s^2", "of the made-up speed"),
    fault="pitot", default_fault_amounts=(2.0, 0.2, 5.0, 1.0),
    filter_index=len(sensor_table.CHECKED), is_queued=True, source="pitot tube", supports=("position",),
    mavlink_failure_unit="SENSOR_AIRSPEED", status_bit="SENSOR_DIFFERENTIAL_PRESSURE",
    test_ratios=(("tas_ratio", "airspeed"),),
)  # fmt: skip


def report() -> dict[str, object]:
    """Return what faults, link, recording and station say of the sensor."""
    sensor_table.SENSORS["pitot_tube"] = (ROW,)
    sensor_table.READINGS[ROW.name] = ROW
    sensor_table.CHECKED = (*sensor_table.CHECKED, ROW)

    from mufly.dynamics import initial_state
    from mufly.estimate import Estimate
    from mufly.estimate.filter.filter_records import ERROR_STATES
    from mufly.estimate.sensor_status import AuxiliaryStates, SensorStatus, describe_reason
    from mufly.flight.record.recorder import FlightRecorder
    from mufly.flight.record.sensor_recording import iterate_readings_and_inputs, make_sensed_row_writer
    from mufly.flight.simulated_plant import Actuators
    from mufly.link import mavlink
    from mufly.link.command_protocol import FAILURE_NAMES
    from mufly.link.estimate_messages import CHECKS_ARRAY_NAME, TEST_RATIOS, pack_sensor_checks
    from mufly.link.telemetry_streams import _SENSOR_BITS
    from mufly.logs.mcap import make_flight_row_layout
    from mufly.quantities.quantity_table import FUSION_STATUSES, READINGS_WITH_FUSION_STATUS
    from mufly.sensors import Reading, Readings, Truth, parse_fault
    from mufly.station import SignalHistory
    from mufly.station.page.frame_feed import list_sensor_states
    from mufly.station.remote.vehicle_telemetry import VehicleTelemetry

    fault = parse_fault("pitot.jump@5s")
    zero = np.zeros(3)
    checks = (SensorStatus(ROW.name, "rejected", ratio=7.3),)
    beliefs = AuxiliaryStates(zero, zero, 0.0, np.zeros(4), np.zeros(2), 1.0, np.ones(len(ERROR_STATES)), checks)
    values = pack_sensor_checks(beliefs)

    recorder = FlightRecorder(None, layout=make_flight_row_layout(sensors=True))
    write = make_sensed_row_writer(recorder)
    truth = Truth(0.5, 100, initial_state(position=(0.0, 0.0, -1.0)), zero, zero, 7.4, 0.0)
    reading = Reading(np.array([3.0, 0.0, -1.0]), 0.45, True, np.diag([0.1, 0.2, 0.3]))
    believed = Estimate(0.5, zero, zero, zero, zero, np.full(8, 1.5), 7.4, auxiliary_states=beliefs)
    write(
        truth, Readings(0.5, {ROW.name: reading}), believed, Actuators(np.zeros(2), np.zeros(2)), (zero,) * 3, "hover"
    )
    dataset = recorder.to_dataset()
    back = next(iterate_readings_and_inputs(dataset))[0][ROW.name]

    telemetry = VehicleTelemetry(SignalHistory(seconds=10.0))
    array = mavlink.MAVLink_debug_float_array_message(10**6, CHECKS_ARRAY_NAME, 1, values + [0.0] * (58 - len(values)))
    wire = mavlink.MAVLink(None)
    for message in (array, *(mavlink.MAVLink_attitude_message(t, 0, 0, 0, 0, 0, 0) for t in (1000, 1010))):
        telemetry.handle_message(1.0, wire.decode(bytearray(message.pack(wire))))
    return {
        "fault": [fault.sensor_name, fault.amount],
        "reason": describe_reason(7, 1.5, ROW.filter_index),
        "failure": FAILURE_NAMES[0][mavlink.FAILURE_UNIT_SENSOR_AIRSPEED],
        "status bit": bool(_SENSOR_BITS & mavlink.MAV_SYS_STATUS_SENSOR_DIFFERENTIAL_PRESSURE),
        "test ratio": TEST_RATIOS["tas_ratio"],
        "message": [FUSION_STATUSES[int(values[3 * READINGS_WITH_FUSION_STATUS.index(ROW.name)])], len(values)],
        "recorded": [back.value.tolist(), back.time_s, back.valid, back.covariance.diagonal().tolist()],
        "recorded innovation": float(dataset["innovation_airspeed"].values[0]),
        "page": list_sensor_states(telemetry.history),
    }


if __name__ == "__main__":
    print(json.dumps(report()))

/* The law around the twin. */
#include "twin.h"

#include <math.h>

/* The law's answer of one period, and the voltage that acts: `voltage_delay` periods late, within the limit. */
static double control(const twin_rig *rig, const twin_law *law, const double *input, twin_memory *memory,
                      double *record)
{
    const int faults = (int)input[TWIN_FAULTS];
    const law_port *const port = law->port;
    double given[PORT_INPUTS], answer[PORT_OUTPUTS];
    uint32_t marks[PORT_MARKS];
    twin_sense(rig, memory, input, &given[PORT_ANGLE], &given[PORT_TORQUE]);
    given[PORT_REFERENCE] = input[TWIN_REFERENCE];
    given[PORT_ACCELERATION] = input[TWIN_ACCELERATION];
    given[PORT_PAYLOAD] = input[TWIN_PAYLOAD];
    const uint32_t tick = memory->tick++;
    if (faults & TWIN_TICK_MISSED) {
        /* The timer's hardware goes on with the voltage it was given last. */
        port->held(law->state, answer, marks);
        answer[PORT_VOLTAGE] = memory->voltage[rig->voltage_delay];
        answer[PORT_TIP_ESTIMATE] = NAN;
    } else {
        if (law->bank) {
            given[PORT_PAYLOAD] =
                port->estimate(law->estimate, law->bank, tick, given[PORT_ANGLE], given[PORT_TORQUE], 0, 0);
        }
        for (int i = (faults & TWIN_TICK_REPEATED) ? 2 : 1; i; --i) {
            port->step(law->state, law->params, tick, given, answer, marks);
        }
    }
    const double voltage = twin_voltage(rig, memory, answer[PORT_VOLTAGE]);

    record[TWIN_OUT_REFERENCE] = input[TWIN_REFERENCE];
    record[TWIN_OUT_ENCODER] = given[PORT_ANGLE];
    record[TWIN_OUT_GAUGE] = given[PORT_TORQUE];
    record[TWIN_OUT_MOTOR_REFERENCE] = answer[PORT_MOTOR_REFERENCE];
    record[TWIN_OUT_VOLTAGE] = voltage;
    record[TWIN_OUT_ASKED] = answer[PORT_VOLTAGE];
    record[TWIN_OUT_MODE] = marks[PORT_MODE];
    record[TWIN_OUT_REASON] = marks[PORT_REASON];
    record[TWIN_OUT_FLAGS] = marks[PORT_FLAGS];
    record[TWIN_OUT_TIP_ESTIMATE] = answer[PORT_TIP_ESTIMATE];
    return voltage;
}

int twin_run(const twin_step *step, const twin_rig *rig, const twin_obstacle *obstacle, const twin_law *law,
             int periods, const double *input, twin_memory *memory, double *record)
{
    for (int k = 0; k < periods; ++k, input += TWIN_INPUTS, record += TWIN_COLUMNS) {
        double largest = 0.0;
        record[TWIN_OUT_MOTOR_ANGLE] = memory->state[0];
        record[TWIN_OUT_MOTOR_VELOCITY] = memory->state[1];
        record[TWIN_OUT_TIP_ANGLE] = twin_output(step, 2, memory->state);
        record[TWIN_OUT_TORQUE] = twin_output(step, 3, memory->state);
        const double torque = rig->torque_per_volt * control(rig, law, input, memory, record);
        for (int j = 0; j < rig->substeps; ++j) {
            const double push = twin_contact(step, obstacle, memory->state);
            largest = fabs(push) > largest ? fabs(push) : largest;
            twin_motor_step(step, rig, torque, push + input[TWIN_TIP_FORCE], memory);
        }
        record[TWIN_OUT_CONTACT] = largest;
        if (!(fabs(memory->state[0]) < 1e6)) {
            return k + 1; /* diverged: later numbers would be infinite */
        }
    }
    return periods;
}

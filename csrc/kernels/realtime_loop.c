/* The controller's loop: wake up on an absolute deadline, take the newest sample, run one period of the law, write
 * the command.
 *
 * Deadlines are multiples of the period after the first one, so that a late period does not shift the others. The
 * number of a period comes from the clock: after missed periods the tick of the law jumps, and its guards react.
 * Without a new sample the law receives NaN, which stands for a lost sample. All transmission faults are thus judged
 * by law.c alone, and a record replays through it to the last bit. */
#include "realtime.h"

#ifdef __linux__

#include <math.h>

/* An arm with its own clock takes the stop when its next period begins. The stop is then repeated, in case that
 * message was lost, and so that no later command overwrites it before it was received. */
static void stop_drive(const realtime_plan *plan, const realtime_io *io, arm_command *command)
{
    command->voltage = 0.0;
    command->mode = ARM_MODE_OFF;
    command->tick++;
    io->write(io->self, command);
    for (int i = 0; io->clocked && i < 2; i++) {
        realtime_sleep_until(plan->clock, realtime_now(plan->clock) + plan->period_ns);
        io->write(io->self, command);
    }
}

/* Wait for an arm that moves no motor yet: return the reason for ending, REALTIME_FINISHED for a sample. */
static int await_sample(const realtime_plan *plan, const realtime_io *io, const arm_command *rest,
                        realtime_sample *sample)
{
    const int64_t last = realtime_now(plan->clock) + plan->patience_ns;
    /* 16 polls per period: the time of arrival, from which the deadlines count, is known to 6 % of a period. */
    const int64_t step = plan->period_ns / (io->clocked ? 16 : 1);
    while (!realtime_signalled()) {
        const int64_t now = realtime_now(plan->clock);
        const int found = io->read(io->self, sample);
        if (found < 0)
            return REALTIME_IO_FAILED;
        if (found > 0 && isfinite(sample->value.motor_angle))
            return sample->period_ns == 0U || sample->period_ns == (uint32_t)plan->period_ns ? REALTIME_FINISHED
                                                                                             : REALTIME_OTHER_PERIOD;
        /* from this message an arm also learns where to send its samples */
        if (io->write(io->self, rest) < 0)
            return REALTIME_IO_FAILED;
        if (now > last)
            return REALTIME_NO_SAMPLE;
        realtime_sleep_until(plan->clock, now + step);
    }
    return REALTIME_SIGNAL;
}

/* One period in `row` and `mark`: 0, or negative if the connection to the arm is broken. */
static int run_period(const realtime_plan *plan, const realtime_io *io, const law_port *law, void *state,
                      const void *params, int64_t tick, double origin, realtime_sample *first, double *row,
                      uint32_t *mark, arm_command *command, int64_t *lost)
{
    realtime_sample sample;
    const int found = io->read(io->self, &sample);
    if (found < 0)
        return found;
    if (found == 0) {
        /* An arm with its own clock has sent nothing since the sample from which the deadlines were counted. */
        sample.value.motor_angle = first ? first->value.motor_angle : (double)NAN;
        sample.value.torque = first ? first->value.torque : (double)NAN;
    }
    row[REALTIME_REFERENCE] = origin + plan->reference[tick];
    row[REALTIME_ACCELERATION] = plan->acceleration[tick];
    row[REALTIME_MOTOR_ANGLE] = sample.value.motor_angle;
    row[REALTIME_TORQUE] = sample.value.torque;
    mark[REALTIME_TICK] = (uint32_t)tick + 1U;
    row[REALTIME_PAYLOAD] = plan->payload;
    if (plan->bank)
        row[REALTIME_PAYLOAD] = law->estimate(plan->estimate, plan->bank, mark[REALTIME_TICK],
                                              row[REALTIME_MOTOR_ANGLE], row[REALTIME_TORQUE], 0, 0);
    law->step(state, params, mark[REALTIME_TICK], row + REALTIME_REFERENCE, row + REALTIME_MOTOR_REFERENCE,
              mark + REALTIME_MODE);
    command->motor_reference = row[REALTIME_MOTOR_REFERENCE];
    command->voltage = row[REALTIME_VOLTAGE];
    command->tick = mark[REALTIME_TICK];
    command->mode = mark[REALTIME_MODE];
    command->reason = mark[REALTIME_REASON];
    command->flags = mark[REALTIME_FLAGS];
    const int written = io->write(io->self, command);
    *lost += written > 0;
    return written < 0 ? written : 0;
}

static void run_periods(const realtime_plan *plan, const realtime_io *io, const law_port *law, void *state,
                        const void *params, realtime_sample *sample, double *record, uint32_t *marks,
                        arm_command *command, realtime_outcome *outcome)
{
    /* With the next deadline half a period after the arrival of a sample, jitter on either side does not change the
     * order. */
    const int64_t start = realtime_now(plan->clock) + plan->period_ns / 2;
    int64_t next = 0;
    outcome->stop = REALTIME_FINISHED;
    while (next < plan->length) {
        const int64_t deadline = start + next * plan->period_ns;
        realtime_sleep_until(plan->clock, deadline);
        const int64_t awake = realtime_now(plan->clock);
        if (realtime_signalled()) {
            outcome->stop = REALTIME_SIGNAL;
            return;
        }
        if (awake < deadline)
            continue; /* a signal that is not recorded */
        const int64_t tick = (awake - start) / plan->period_ns;
        if (tick >= plan->length)
            return;
        double *const row = record + outcome->count * REALTIME_COLUMNS;
        uint32_t *const mark = marks + outcome->count * REALTIME_MARKS;
        if (run_period(plan, io, law, state, params, tick, outcome->origin, next == 0 ? sample : NULL, row, mark,
                       command, &outcome->lost) < 0) {
            outcome->stop = REALTIME_IO_FAILED;
            return;
        }
        row[REALTIME_DEADLINE] = 1e-9 * (double)(tick * plan->period_ns);
        row[REALTIME_LATENCY] = 1e-9 * (double)(awake - deadline);
        row[REALTIME_WORK] = 1e-9 * (double)(realtime_now(plan->clock) - awake);
        outcome->count++;
        if (command->mode == ARM_MODE_OFF) {
            outcome->stop = REALTIME_LAW_OFF;
            return;
        }
        next = tick + 1;
    }
}

void realtime_run(const realtime_plan *plan, const realtime_io *io, const law_port *law, void *state,
                  const void *params, double *record, uint32_t *marks, realtime_outcome *outcome)
{
    const realtime_outcome none = {0};
    static const arm_command off = {0.0, 0.0, 0U, ARM_MODE_OFF, 0U, 0U}; /* a drive that is off needs no reference */
    arm_command command = {0.0, 0.0, 0U, 0U, 0U, 0U};
    realtime_sample sample = {0U, {0.0, 0.0}};
    *outcome = none;
    realtime_watch_signals();
    realtime_stop_on_fault(io, &off);
    outcome->privileges = realtime_prepare(plan->priority, plan->lock_memory);
    outcome->stop = await_sample(plan, io, &command, &sample);
    outcome->period_ns = sample.period_ns;
    if (outcome->stop == REALTIME_FINISHED) {
        outcome->origin = sample.value.motor_angle - plan->reference[0];
        command.motor_reference = sample.value.motor_angle;
        run_periods(plan, io, law, state, params, &sample, record, marks, &command, outcome);
    }
    stop_drive(plan, io, &command);
    realtime_stop_on_fault(NULL, NULL);
    realtime_relax(&outcome->privileges);
    realtime_release_signals();
}

void realtime_bare(const realtime_plan *plan, double *latency, realtime_outcome *outcome)
{
    const realtime_outcome none = {0};
    *outcome = none;
    realtime_watch_signals();
    outcome->privileges = realtime_prepare(plan->priority, plan->lock_memory);
    const int64_t start = realtime_now(plan->clock) + plan->period_ns;
    for (int64_t k = 0; k < plan->length && !realtime_signalled(); k++) {
        realtime_sleep_until(plan->clock, start + k * plan->period_ns);
        latency[k] = 1e-9 * (double)(realtime_now(plan->clock) - (start + k * plan->period_ns));
        outcome->count++;
    }
    realtime_relax(&outcome->privileges);
    realtime_release_signals();
}

#endif

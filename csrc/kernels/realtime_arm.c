/* The twin in real time, for a controller that reaches it by messages: the same steps as twin_law.c, on a clock.
 *
 * At the beginning of a period the arm takes the newest command, samples its sensors, sends the sample, and moves
 * for a period under the voltage of that command, which is the one period of delay of a board. It never waits. */
#include "realtime.h"

#ifdef __linux__

#include <math.h>

typedef struct {
    int connected;
    int64_t silent; /* periods since the last command */
    double voltage;
} served_controller;

static void leave(realtime_channel *channel, served_controller *who)
{
    realtime_next_run(channel);
    who->connected = 0;
    who->voltage = 0.0;
}

/* Receive from the controller, or forget it after too long a silence, with the drive off. */
static void listen_once(const served_plan *plan, realtime_channel *channel, served_controller *who,
                        served_outcome *outcome)
{
    realtime_message command;
    if (realtime_newest(channel, MESSAGE_COMMAND, &command)) {
        who->silent = 0;
        if (command.words[0] == ARM_MODE_OFF) {
            leave(channel, who);
            return;
        }
        outcome->controllers += !who->connected;
        who->connected = 1;
        who->voltage = command.words[0] == ARM_MODE_IDLE ? 0.0 : command.second;
    } else if (who->connected && ++who->silent >= plan->watchdog) {
        outcome->silences++;
        leave(channel, who);
    }
}

static void send_sample(const served_plan *plan, realtime_channel *channel, int64_t tick, double angle, double torque)
{
    realtime_message sample = {.kind = MESSAGE_SAMPLE,
                               .tick = (uint32_t)tick,
                               .first = angle,
                               .second = torque,
                               .words = {(uint32_t)plan->period_ns, 0U, 0U}};
    (void)realtime_send(channel, &sample); /* its controller notices a lost one by the number */
}

void realtime_serve(const served_plan *plan, realtime_channel *channel, const twin_step *step, const twin_rig *rig,
                    twin_memory *memory, double *record, served_outcome *outcome)
{
    const served_outcome none = {0};
    served_controller who = {0, 0, 0.0};
    double input[TWIN_INPUTS] = {0.0};
    input[TWIN_ENCODER_GAIN] = input[TWIN_GAUGE_GAIN] = 1.0;
    *outcome = none;
    realtime_watch_signals();
    outcome->privileges = realtime_prepare(plan->priority, 0);
    realtime_next_run(channel);
    const int64_t start = realtime_now(plan->clock) + plan->period_ns;
    for (int64_t k = 0; k < plan->length; k++, record += SERVED_COLUMNS) {
        double angle;
        double torque;
        realtime_sleep_until(plan->clock, start + k * plan->period_ns);
        if (realtime_signalled()) {
            outcome->stop = REALTIME_SIGNAL;
            break;
        }
        listen_once(plan, channel, &who, outcome);
        if (plan->once && outcome->controllers > 0 && !who.connected)
            break;
        input[TWIN_GAUGE_ERROR] = plan->gauge_error[k];
        twin_sense(rig, memory, input, &angle, &torque);
        send_sample(plan, channel, k, angle, torque);
        outcome->late += realtime_now(plan->clock) > start + (k + 1) * plan->period_ns;
        twin_drive(step, rig, memory, who.voltage, record);
        record[SERVED_CONNECTED] = who.connected;
        outcome->count = k + 1;
        if (!(fabs(memory->state[0]) < 1e6))
            break; /* diverged: later numbers would be infinite */
    }
    outcome->rejected = channel->rejected;
    realtime_relax(&outcome->privileges);
    realtime_release_signals();
}

#endif

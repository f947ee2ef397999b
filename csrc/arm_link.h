/* The arm's end of the connection to `fraclink tune` and `fraclink run-realtime`: messages over a serial line or any
 * other.
 *
 * Once per period, from a timer, in this order, which determines the delay that fraclink measures and designs for:
 *
 *     while (bytes have come) arm_link_take(&link, byte);
 *     angle, torque = encoder and gauge now;
 *     if (arm_link_period(&link, angle, torque, &voltage, message)) send the message;
 *     give the voltage to the amplifier; it is 0 where the drive must be off.
 *
 * ISO C99, no memory except the struct, no library; `float` and `double` may be the same type, as on an AVR. */
#ifndef FRACLINK_ARM_LINK_H
#define FRACLINK_ARM_LINK_H

#include <stdint.h>

#define ARM_LINK_MESSAGE 56

typedef struct {
    uint32_t period_ns;
    uint16_t watchdog; /* silent periods after which the drive is off */
    uint64_t seed;     /* for drawing the numbers of runs */

    uint64_t run;     /* number of the present run */
    uint64_t former;  /* number of the previous run, whose stop may be repeated */
    uint32_t taken;   /* sequence of the last command; 0: none yet */
    uint32_t sent;    /* sequence of the last sample */
    uint32_t period;  /* number of this period, from 0 */
    uint16_t silent;  /* periods without a command */
    uint8_t heard;    /* a controller is connected */
    uint8_t came;     /* a command has arrived since the last period */
    uint8_t held;     /* bytes of an incomplete message */
    uint32_t damaged; /* messages with a wrong checksum, version or kind */
    float voltage;    /* voltage of the last command [V]; 0 where the drive must be off */
    uint8_t bytes[ARM_LINK_MESSAGE];
} arm_link;

/* Begin. `period_us` is the period of the timer. `seed`: anything that differs from one start to the next, such as
 * the noise of an open analog input; a command from before the start is then not obeyed. */
void arm_link_begin(arm_link *link, uint32_t period_us, uint32_t seed);
/* Take one byte of the line. */
void arm_link_take(arm_link *link, uint8_t byte);
/* One period: takes the motor angle at the gear's output [rad] and the gauge's torque [N m], and gives the voltage
 * for the amplifier [V]. Returns 1 if `message` is to be sent, 0 while no controller has called. */
int arm_link_period(arm_link *link, float angle, float torque, float *voltage, uint8_t message[ARM_LINK_MESSAGE]);

#endif

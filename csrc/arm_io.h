/* What connects the real-time loop of `fraclink run-realtime` to a board: two functions in a library of yours.
 *
 *   cc -std=c99 -O2 -shared -fPIC my_board.c -o my_board.so
 *   fraclink run-realtime design.json --io library:./my_board.so
 *
 * Both are called once in every control period, from one thread, read first. They must neither allocate memory nor
 * wait longer than the period can spare: what they take is part of the time of the step that the run reports.
 */
#ifndef FRACLINK_ARM_IO_H
#define FRACLINK_ARM_IO_H

#include <stdint.h>

/* A library is refused unless it was compiled with the header of the release that loads it. */
#define ARM_IO_VERSION 1U

/* Modes of a command; the others are in law.h. In both of these the drive must be off, and the motor reference means
 * nothing: idle before the law has started, off for the safe stop, which is the last command of every run. */
#define ARM_MODE_IDLE 0U
#define ARM_MODE_OFF 4U

typedef struct {
    double motor_angle; /* at the gear's output [rad] */
    double torque;      /* of the gauge at the link's root [N m] */
} arm_sample;

typedef struct {
    double motor_reference; /* for a robot with a position servo of its own [rad] */
    double voltage;         /* for a motor that the law drives [V] */
    uint32_t tick;          /* number of the period; it jumps where periods were missed */
    uint32_t mode;
    uint32_t reason;
    uint32_t flags;
} arm_command;

#ifdef __cplusplus
extern "C" {
#endif

/* ARM_IO_VERSION, as this library was compiled. */
uint32_t arm_io_version(void);
/* Optional: called before the first period; anything but 0 refuses to start. */
int arm_open(void);
/* Give this period's sample: 0 where there is one, else 1, and the law sees a lost sample. Negative stops the run. */
int arm_read(arm_sample *sample);
/* Apply a command: 0, or negative where the drive did not take it, which stops the run. */
int arm_write(const arm_command *command);
/* Optional: called once, after the last command. */
void arm_close(void);

#ifdef __cplusplus
}
#endif

#endif

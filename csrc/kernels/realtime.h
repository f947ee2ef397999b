/* The law in real time: a loop with absolute deadlines around some connection to an arm. Linux only, desktop only. */
#ifndef FRACLINK_REALTIME_H
#define FRACLINK_REALTIME_H

#include <stddef.h>
#include <stdint.h>

#include "twin.h"

/* ---- what goes to and fro in a period ---- */

/* Modes of a command; the others are in law.h. In both of these the drive must be off and the motor reference is
 * meaningless: idle before the law has started, off for the safe stop, which is the last command of every run. */
#define ARM_MODE_IDLE 0U
#define ARM_MODE_OFF 4U

typedef struct {
    double motor_angle; /* at the gear's output [rad] */
    double torque;      /* at the strain gauge at the link's root [N m] */
} arm_sample;

typedef struct {
    double motor_reference; /* for a robot with a position servo of its own [rad] */
    double voltage;         /* for a motor that the law drives [V] */
    uint32_t tick;          /* number of the period; it jumps where periods were missed */
    uint32_t mode;
    uint32_t reason;
    uint32_t flags;
} arm_command;

/* ---- the clock ---- */

/* Time in nanoseconds. Every function below takes NULL for the machine's CLOCK_MONOTONIC, or the clock of a test. */
typedef struct {
    void *self;
    int64_t (*now)(void *self);
    void (*sleep_until)(void *self, int64_t time_ns);
} realtime_clock;

int64_t realtime_now(const realtime_clock *clock);
/* Sleep until that time, or until a signal. */
void realtime_sleep_until(const realtime_clock *clock, int64_t time_ns);

/* ---- how samples come and commands go ---- */

typedef struct {
    uint32_t period_ns; /* period of an arm with its own clock; 0: it has none, and samples when requested */
    arm_sample value;
} realtime_sample;

/* `read` returns 1 with a new sample, 0 without one, negative if the connection is broken; `write` returns 0, 1 if
 * the command may be lost, negative if the connection is broken. */
typedef struct {
    void *self;
    int clocked; /* the arm has its own clock and sends samples by it */
    int direct;  /* `write` is C code and needs no interpreter: a fault handler may call it */
    int (*read)(void *self, realtime_sample *sample);
    int (*write)(void *self, const arm_command *command);
} realtime_io;

/* ---- the controller's loop ---- */

enum {
    REALTIME_FINISHED,
    REALTIME_SIGNAL,    /* a signal that would have ended or stopped the process */
    REALTIME_LAW_OFF,   /* the law requires the drive to be switched off */
    REALTIME_NO_SAMPLE, /* none before the patience was over: the law never ran */
    REALTIME_IO_FAILED,
    REALTIME_OTHER_PERIOD /* the arm runs at another period */
};

/* Columns of the record: one row for every period that ran; the law's inputs and outputs in the order of its port. */
enum {
    REALTIME_DEADLINE, /* deadline of this period, from the first deadline [s] */
    REALTIME_LATENCY,  /* from the deadline to being awake [s] */
    REALTIME_WORK,     /* from being awake to the command being written [s] */
    REALTIME_REFERENCE,
    REALTIME_ACCELERATION,
    REALTIME_MOTOR_ANGLE, /* NaN where no sample came, as passed to the law */
    REALTIME_TORQUE,
    REALTIME_PAYLOAD, /* payload given to the law [kg]; 0: none */
    REALTIME_MOTOR_REFERENCE,
    REALTIME_VOLTAGE,
    REALTIME_COMPENSATION,
    REALTIME_TIP_ESTIMATE,
    REALTIME_ERROR,
    REALTIME_COLUMNS
};
enum { REALTIME_TICK, REALTIME_MODE, REALTIME_REASON, REALTIME_FLAGS, REALTIME_MARKS };

typedef struct {
    int64_t period_ns;
    int64_t length; /* periods */
    const double *reference;
    const double *acceleration;
    double payload; /* payload given to the law [kg]; 0: none */
    const void *bank; /* payload_params in the law's precision, whose estimate is given to the law; null: `payload` */
    void *estimate;
    int64_t patience_ns; /* for the first sample */
    int priority;        /* of SCHED_FIFO; 0: not requested */
    int lock_memory;
    const realtime_clock *clock;
} realtime_plan;

/* The state of a thread before it was prepared for real time, and the errno of a denied request, else 0. */
typedef struct {
    int policy;
    int priority;
    int slack;
    int scheduled;
    int locked;
    int priority_error;
    int memory_error;
} realtime_privileges;

typedef struct {
    int stop;
    int64_t count;      /* rows of the record */
    int64_t lost;       /* commands that the connection did not take */
    double origin;      /* added to the reference [rad] */
    uint32_t period_ns; /* that of the arm; 0: it has none */
    realtime_privileges privileges;
} realtime_outcome;

/* Run; the last command is always a stop: voltage 0, the motor reference held, ARM_MODE_OFF. */
void realtime_run(const realtime_plan *plan, const realtime_io *io, const law_port *law, void *state,
                  const void *params, double *record, uint32_t *marks, realtime_outcome *outcome);

/* The bare loop for comparison: sleep on the same deadlines and record the latency [s]. */
void realtime_bare(const realtime_plan *plan, double *latency, realtime_outcome *outcome);

/* ---- messages of MESSAGE_BYTES, by a datagram or a serial line; docs/reference/file-formats.md ---- */

#define MESSAGE_BYTES 56
#define MESSAGE_TAG 16 /* bytes of the tag after it, where both sides share a key */
#define MESSAGE_SAMPLE 1U
#define MESSAGE_COMMAND 2U

typedef struct {
    uint32_t kind;
    uint32_t sequence;
    uint32_t tick;
    double first;  /* motor angle, or motor reference */
    double second; /* torque, or voltage */
    uint32_t words[3]; /* period_ns, 0, 0, or mode, reason, flags */
    uint64_t run; /* drawn by the arm for one visit of a controller and returned in its commands; 0: not known yet */
} realtime_message;

/* Return 1, or 0 for bytes that are not a message: wrong magic, version or checksum. */
int realtime_decode(const uint8_t bytes[MESSAGE_BYTES], realtime_message *message);

/* A connection for messages between two processes. `receive` returns 1 with a message, 0 without; `send` returns 0,
 * or 1 if it was not taken. While an arm has `kept` its controller, it receives from no other. */
typedef struct realtime_channel {
    int (*send)(struct realtime_channel *self, const uint8_t bytes[MESSAGE_BYTES]);
    int (*receive)(struct realtime_channel *self, uint8_t bytes[MESSAGE_BYTES]);
    /* Compute the tag of a datagram with the shared key; 0, or -1. NULL without a key. */
    int (*seal)(void *sealer, const uint8_t bytes[MESSAGE_BYTES], uint8_t tag[MESSAGE_TAG]);
    void *sealer;
    int file;
    int is_arm;
    int kept;          /* a controller is connected */
    uint32_t sent;
    uint32_t taken;    /* sequence of the last message that was used; 0: none yet */
    uint32_t rejected; /* messages that were damaged, of another kind or run, or too old */
    uint64_t run;      /* number of the present run; 0 at a controller that has heard no arm yet */
    uint64_t former;   /* at an arm: the previous run, whose stop may be repeated */
} realtime_channel;

/* Both return NULL with errno set; the caller still owns `file`, and frees the channel. A controller's socket is
 * connected, an arm's is bound. */
realtime_channel *realtime_open_socket(int file, int is_arm);
realtime_channel *realtime_open_serial(int file, int is_arm);

/* Number a message within its run and send it, from an arm only to its controller; 0, or 1 if it was not taken. */
int realtime_send(realtime_channel *channel, realtime_message *message);
/* The newest message of `kind` since the last call; 1 or 0. */
int realtime_newest(realtime_channel *channel, uint32_t kind, realtime_message *message);
/* End a visit at the arm: forget the controller, and draw the number of the next run. */
void realtime_next_run(realtime_channel *channel);
/* The controller's side of a channel. */
realtime_io realtime_io_of(realtime_channel *channel);

/* ---- the simulated arm ---- */

/* Columns of the record: those of twin_drive, and 1 while a controller is connected. */
enum { SERVED_CONNECTED = TWIN_DRIVEN_COLUMNS, SERVED_COLUMNS };

typedef struct {
    int64_t period_ns;
    int64_t length;     /* periods */
    int64_t watchdog;   /* periods without a command after which the drive is switched off */
    int once;           /* end when the first controller has left */
    const double *gauge_error; /* [N m], one value per period */
    int priority;       /* of SCHED_FIFO; 0: not requested */
    const realtime_clock *clock;
} served_plan;

typedef struct {
    int stop;           /* REALTIME_FINISHED or REALTIME_SIGNAL */
    int64_t count;      /* rows of the record */
    int64_t late;       /* periods that began after their own end */
    int64_t controllers;
    int64_t silences;   /* controllers that left without a stop */
    uint32_t rejected;
    realtime_privileges privileges;
} served_outcome;

/* Run the twin in real time; `memory->voltage` has queue + 1 places. */
void realtime_serve(const served_plan *plan, realtime_channel *channel, const twin_step *step, const twin_rig *rig,
                    twin_memory *memory, double *record, served_outcome *outcome);

/* ---- the process ---- */

/* Between these two calls, signals that would end or stop the process are recorded instead of obeyed; calls may nest
 * and come from any thread. SIGKILL and SIGSTOP cannot be caught: for them the board's own watchdog must switch the
 * drive off. */
void realtime_watch_signals(void);
void realtime_release_signals(void);
int realtime_signalled(void);
/* A fault of the process (SIGSEGV, SIGABRT …) writes `stop` to `io` before it ends the process, if the connection is
 * `direct`; NULL ends that. For one loop at a time: the last one that registered. */
void realtime_stop_on_fault(const realtime_io *io, const arm_command *stop);

/* Request SCHED_FIFO with a `priority` above 0 and locked memory; a denied request is recorded and not fatal. */
realtime_privileges realtime_prepare(int priority, int lock_memory);
void realtime_relax(const realtime_privileges *before);

#endif

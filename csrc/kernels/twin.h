/* The twin: a hub with friction, a flexible link in modes, sensors, and law.c around them. Desktop only. */
#ifndef FRACLINK_TWIN_H
#define FRACLINK_TWIN_H

#include <stdint.h>

#include "law_port.h"

#define TWIN_OUTPUTS 6 /* hub angle, hub velocity, tip angle, gauge torque, tip velocity, material's moment */

/* One exact step of the linear twin; transition is column-major with `stride` rows, the rest is padded by 0. */
typedef struct {
    int states;
    int stride; /* states rounded up to a multiple of 8, so that every loop over them consists of whole vectors */
    const double *transition;
    const double *hub;     /* state change per unit of hub input (net torque, reference or velocity) */
    const double *tip;     /* state change per newton on the tip */
    const double *outputs; /* TWIN_OUTPUTS rows of `stride` */
} twin_step;

/* Motor, amplifier and sensors. */
typedef struct {
    int substeps;            /* steps per control period */
    int voltage_delay;       /* control periods between reading the sensors and the voltage's effect */
    int gauge_delay;         /* age in steps of the oldest torque that the gauge needs */
    double torque_per_volt;  /* at the link's side [N m/V] */
    double voltage_limit;    /* of the amplifier [V] */
    double coulomb;          /* sliding friction [N m] */
    double stiction;         /* breakaway friction [N m], >= coulomb */
    double angle_quantum;    /* encoder count [rad], 0: none */
    double gauge_quantum;    /* [N m], 0: none */
    double gauge_limit;      /* [N m], infinity: none */
    double gauge_gain;       /* what the gauge shows of a torque [1] */
    double gauge_weight[4];  /* of the four oldest torques: 1, 0, 0, 0 where the delay is a whole number of steps */
} twin_rig;

/* An obstacle: a stop at `angle` that pushes back along `side` (+1: the tip may not pass above) as a spring. */
typedef struct {
    double angle;
    double stiffness; /* [N/m], 0: no obstacle */
    double damping;   /* [N s/m], loss while pressed in */
    double length;    /* of the link [m] */
    double side;
} twin_obstacle;

/* What the loop remembers besides the link's states and the law. */
typedef struct {
    double *state;   /* stride */
    double *gauge;   /* queue of gauge_delay + 1 true torques, the oldest first */
    double *voltage; /* queue of voltage_delay voltages, the next one first; then the last one asked for */
    double *scratch; /* stride */
    double angle;    /* what the sensors gave last, for the fault of a frozen channel */
    double torque;
    int stuck;
    uint32_t tick;
} twin_memory;

/* The law that drives it: blocks and states of the port's precision. */
typedef struct {
    const law_port *port;
    const void *params;
    void *state;
    const void *bank; /* payload_params, and its payload_state; null: the inputs' payload */
    void *estimate;
} twin_law;

/* matrix <- e^matrix, size x size by rows; `work` has room for two more. Plain arithmetic in one order, so that an arm's
 * step has the same bits on every machine, and in a browser: the result of a library would depend on its BLAS. */
void twin_exponential(int size, double *matrix, double *work);

/* Columns of the inputs of one control period. */
enum {
    TWIN_REFERENCE,
    TWIN_VELOCITY,
    TWIN_ACCELERATION,
    TWIN_GAUGE_ERROR, /* offset + drift + noise [N m] */
    TWIN_TIP_FORCE,   /* [N] */
    TWIN_FAULTS,      /* bits below; 0 on a healthy rig */
    TWIN_ENCODER_GAIN,
    TWIN_ENCODER_ERROR,
    TWIN_ENCODER_VALUE,
    TWIN_GAUGE_GAIN,
    TWIN_GAUGE_VALUE,
    TWIN_PAYLOAD, /* that the law is given [kg]; 0: none */
    TWIN_INPUTS
};

/* Faults of one period, between the sensors and the law. */
#define TWIN_ENCODER_REPLACED 1
#define TWIN_GAUGE_REPLACED 2
#define TWIN_ENCODER_FROZEN 4
#define TWIN_GAUGE_FROZEN 8
#define TWIN_SWAPPED 16
#define TWIN_TICK_MISSED 32
#define TWIN_TICK_REPEATED 64

/* Readings of one period as its fault leaves them; `last_angle` and `last_torque` are those of the period before. Twin
 * and loop share this function, so that "frozen" means the same in both. */
static inline void twin_break(const double *input, double last_angle, double last_torque, double *angle, double *torque)
{
    const int faults = (int)input[TWIN_FAULTS];
    double a = (faults & TWIN_ENCODER_FROZEN) ? last_angle : *angle;
    double g = (faults & TWIN_GAUGE_FROZEN) ? last_torque : *torque;
    a = (faults & TWIN_ENCODER_REPLACED) ? input[TWIN_ENCODER_VALUE] : a;
    g = (faults & TWIN_GAUGE_REPLACED) ? input[TWIN_GAUGE_VALUE] : g;
    *angle = (faults & TWIN_SWAPPED) ? g : a;
    *torque = (faults & TWIN_SWAPPED) ? a : g;
}

/* Columns of the record of one control period, at its beginning. */
enum {
    TWIN_OUT_REFERENCE,
    TWIN_OUT_MOTOR_ANGLE,
    TWIN_OUT_TIP_ANGLE,
    TWIN_OUT_TORQUE,
    TWIN_OUT_ENCODER,
    TWIN_OUT_GAUGE,
    TWIN_OUT_MOTOR_REFERENCE,
    TWIN_OUT_VOLTAGE,
    TWIN_OUT_ASKED,
    TWIN_OUT_MODE,
    TWIN_OUT_REASON,
    TWIN_OUT_FLAGS,
    TWIN_OUT_MOTOR_VELOCITY,
    TWIN_OUT_CONTACT,
    TWIN_OUT_TIP_ESTIMATE, /* not a number in a period that the law missed */
    TWIN_COLUMNS
};

/* Encoder and gauge as the controller reads them now, faults included. */
void twin_sense(const twin_rig *rig, twin_memory *memory, const double *input, double *angle, double *torque);

/* One output of the linear twin. */
double twin_output(const twin_step *step, int row, const double *state);

/* Push of the obstacle on the tip [N]: never a pull, whatever the damping says. */
double twin_contact(const twin_step *step, const twin_obstacle *obstacle, const double *state);

/* One step of motor and link under a motor torque and a force on the tip. */
void twin_motor_step(const twin_step *step, const twin_rig *rig, double torque, double force, twin_memory *memory);

/* The voltage of this period: the oldest of the queue, within the amplifier's limit. The one asked for joins the queue. */
double twin_voltage(const twin_rig *rig, twin_memory *memory, double asked);

/* The arm at the beginning of a period, and the voltage that acts in it. */
enum {
    TWIN_DRIVEN_TIP_ANGLE,
    TWIN_DRIVEN_MOTOR_ANGLE,
    TWIN_DRIVEN_MOTOR_VELOCITY,
    TWIN_DRIVEN_TORQUE,
    TWIN_DRIVEN_VOLTAGE,
    TWIN_DRIVEN_COLUMNS
};

/* One period of an arm without a law, whose amplifier is asked for a voltage; not a number counts as 0. */
void twin_drive(const twin_step *step, const twin_rig *rig, twin_memory *memory, double asked, double *row);

/* Run the law on the twin for `periods` control periods: rows of TWIN_INPUTS in, rows of TWIN_COLUMNS out. Returns the
 * number of periods run, less than asked for only if the twin diverged. */
int twin_run(const twin_step *step, const twin_rig *rig, const twin_obstacle *obstacle, const twin_law *law,
             int periods, const double *input, twin_memory *memory, double *record);

#endif

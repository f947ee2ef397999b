/* The twin: a hub with friction, a flexible link in modes, sensors, and law.c around them. Desktop only. */
#ifndef FRACLINK_TWIN_H
#define FRACLINK_TWIN_H

#include <stdint.h>

#include "law.h"

#define TWIN_OUTPUTS 6 /* hub angle, hub velocity, tip angle, gauge torque, tip velocity, material's moment */

/* One exact step of the linear twin; transition is column-major with `stride` rows, the rest is padded by 0. */
typedef struct {
    int states;
    int stride; /* states rounded up to a multiple of 8, so that every loop below is whole vectors */
    const double *transition;
    const double *hub;     /* state change per unit of hub input (net torque, reference or velocity) */
    const double *tip;     /* state change per newton on the tip */
    const double *outputs; /* TWIN_OUTPUTS rows of `stride` */
} twin_step;

/* Motor, amplifier and sensors. */
typedef struct {
    int substeps;            /* steps per control period */
    int voltage_delay;       /* control periods between reading the sensors and the voltage's effect */
    int gauge_delay;         /* steps of the strain amplifier's delay */
    double torque_per_volt;  /* at the link's side [N m/V] */
    double voltage_limit;    /* of the amplifier [V] */
    double coulomb;          /* sliding friction [N m] */
    double stiction;         /* breakaway friction [N m], >= coulomb */
    double angle_quantum;    /* encoder count [rad], 0: none */
    double gauge_gain;       /* reading per true torque, 1: calibrated */
    double gauge_quantum;    /* [N m], 0: none */
    double gauge_limit;      /* [N m], infinity: none */
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
    double *state;    /* stride */
    double *gauge;    /* ring of gauge_delay + 1 true torques, the oldest first */
    double *voltage;  /* queue of voltage_delay voltages, the next one first; at least 1 long */
    double *scratch;  /* stride */
    int stuck;
    uint32_t tick;
} twin_memory;

/* March the linear twin: one hub input per period, `substeps` steps each, outputs after every step. */
void twin_march(const twin_step *step, int periods, int substeps, const double *input, double *state,
                double *scratch, double *output);

/* Encoder and gauge as the controller reads them now. */
void twin_sense(const twin_step *step, const twin_rig *rig, const twin_memory *memory, double gauge_error,
                double *angle, double *torque);

#define TWIN_COLUMNS 14
/* Run the law on the twin for `periods` control periods. Inputs per period: reference (angle, velocity,
 * acceleration), gauge_error (offset + drift + noise, N m), tip force (N). Rows of `record`: reference, true
 * hub angle, true tip angle, true gauge torque, read hub angle, read torque, motor reference, voltage applied,
 * voltage asked, mode, reason, flags, hub velocity, largest contact force. Returns the number of periods run. */
int twin_run(const twin_step *step, const twin_rig *rig, const twin_obstacle *obstacle, const law_params *params,
             int periods, const double *reference, const double *gauge_error, const double *tip_force,
             law_state *law, twin_memory *memory, double *record);

#endif

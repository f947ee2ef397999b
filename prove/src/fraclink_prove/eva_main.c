/* Every input and the whole state arbitrary, for ever: what the prover (Frama-C Eva) has to show safe. */
#include "law.h"
#include "law_data.h"

extern volatile unsigned char any_byte;
extern volatile law_real any_real;
extern volatile uint32_t any_word;

static void fill(unsigned char *bytes, unsigned long size)
{
    for (unsigned long i = 0; i < size; i++) {
        bytes[i] = any_byte;
    }
}

void eva_main(void)
{
    static law_state state;
    static law_wiring wiring;
    law_input in;
    law_output out;
    fill((unsigned char *)&state, sizeof(state));
    fill((unsigned char *)&wiring, sizeof(wiring));
    if (any_word != 0U) {
        (void)law_init(&state, &law_data);
    }
    while (any_word != 0U) {
        in.tick = any_word;
        in.reference = any_real;
        in.reference_acceleration = any_real;
        in.motor_angle = any_real;
        in.torque = any_real;
        in.payload = any_real;
        law_step(&state, &law_data, &in, &out);
        /*@ assert \is_finite(out.motor_reference); */
        /*@ assert out.motor_reference <= law_data.motor_limit; */
        /*@ assert out.motor_reference >= -law_data.motor_limit; */
        /*@ assert \is_finite(out.voltage); */
        /*@ assert out.voltage <= law_data.voltage_limit; */
        /*@ assert out.voltage >= -law_data.voltage_limit; */
        /*@ assert out.mode <= 4; */
        (void)law_check_wiring(&wiring, &law_data, in.motor_angle, in.torque);
    }
}

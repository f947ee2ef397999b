/* Runs the fuzz target on pseudo-random bytes without libFuzzer, and the refusals of law_check: for coverage,
 * for mutants, and for compilers that have no fuzzer. Usage: drive RUNS. Prints a hash of all outputs' effects. */
#include "fuzz.c"

static uint32_t word = 12345U;

static unsigned char next_byte(void)
{
    word = (word * 1664525U) + 1013904223U;
    return (unsigned char)(word >> 24U);
}

/* CRC-32 of what follows the field of the CRC, by the register whose highest bit goes out first: its bits are
 * those of the reflected one of law.c in the opposite order. */
static uint32_t crc_32(const law_params *block)
{
    const unsigned char *bytes = (const unsigned char *)block;
    uint32_t crc = 0xFFFFFFFFU;
    uint32_t turned = 0U;
    for (size_t i = offsetof(law_params, crc) + sizeof block->crc; i < sizeof *block; i++) {
        for (uint32_t bit = 0U; bit < 8U; bit++) {
            const uint32_t fed = (crc >> 31U) ^ (((uint32_t)bytes[i] >> bit) & 1U);
            crc = (crc << 1U) ^ ((fed != 0U) ? 0x04C11DB7U : 0U);
        }
    }
    for (uint32_t bit = 0U; bit < 32U; bit++) {
        turned |= ((crc >> bit) & 1U) << (31U - bit);
    }
    return ~turned;
}

static uint32_t in_each_byte(uint32_t mode)
{
    return mode | (mode << 8U) | (mode << 16U) | (mode << 24U);
}

static void refusals(void)
{
    law_params block = law_data;
    law_state state;
    law_input in = {0};
    law_output out;
    require(law_check(&block) == LAW_OK);
    block.version++;
    require(law_check(&block) == LAW_BAD_VERSION);
    block = law_data;
    block.size--;
    require(law_check(&block) == LAW_BAD_SIZE);
    block = law_data;
    block.precision ^= 12U;
    require(law_check(&block) == LAW_BAD_SIZE);
    block = law_data;
    block.direct += (law_real)0.5F;
    require(law_check(&block) == LAW_BAD_CRC);
    require(law_init(&state, &block) == LAW_BAD_CRC);
    for (uint32_t k = 1U; k < 5U; k++) {
        in.tick = k;
        law_step(&state, &block, &in, &out);
        require((out.mode == LAW_IDLE) && (out.voltage == (law_real)0) && (out.reason == LAW_BAD_CRC));
    }
    /* counts beyond the arrays, under a valid CRC (the caller gives one made elsewhere) */
    block = law_data;
    for (uint32_t i = 0U; i < 3U; i++) {
        block = law_data;
        block.real_modes = (i == 0U) ? 99U : block.real_modes;
        block.pair_modes = (i == 1U) ? 99U : block.pair_modes;
        block.forward_modes = (i == 2U) ? 99U : block.forward_modes;
        block.crc = crc_32(&block);
        require(law_check(&block) == LAW_BAD_COUNTS);
    }
    block = law_data;
    block.options = 0U; /* a robot that has its own position servo */
    require(law_init(&state, &law_data) == LAW_OK);
    in.tick = 0U;
    law_step(&state, &law_data, &in, &out);
    for (uint32_t k = 1U; k < 5U; k++) {
        in.tick = k;
        in.torque = (law_real)k / (law_real)100;
        law_step(&state, &block, &in, &out);
        require((out.voltage == (law_real)0) && (out.compensation == (law_real)0));
    }
    in.torque = (law_real)0;
    block = law_data;
    block.real_modes = 99U;
    block.pair_modes = 99U;
    block.forward_modes = 99U;
    block.crc = law_data.crc;
    require(law_init(&state, &law_data) == LAW_OK);
    law_step(&state, &law_data, &in, &out);
    for (uint32_t k = 6U; k < 12U; k++) { /* a block that went bad after the start: bounded all the same */
        in.tick = k;
        in.torque = (law_real)k / (law_real)100;
        law_step(&state, &block, &in, &out);
        require(isfinite(out.motor_reference));
    }
}

static void wiring(void)
{
    for (int sign = -1; sign <= 1; sign++) {
        law_wiring test = {0};
        uint32_t reason = LAW_NOT_MOVED;
        require(law_check_wiring(&test, &law_data, (law_real)0, (law_real)0) == LAW_NOT_MOVED);
        for (int k = 1; k <= 40; k++) {
            const law_real angle = (law_real)k / (law_real)50;
            reason = law_check_wiring(&test, &law_data, angle, (law_real)sign * angle);
        }
        require(reason == ((sign > 0) ? LAW_OK : ((sign < 0) ? LAW_GAUGE_REVERSED : LAW_GAUGE_DEAD)));
    }
}

/* A quiet arm for long enough that states die away and counters run. */
static uint32_t quiet(void)
{
    law_state state;
    law_input in = {0};
    law_output out;
    uint32_t hash = 0x811C9DC5U;
    require(law_init(&state, &law_data) == LAW_OK);
    for (uint32_t k = 1U; k < 60000U; k++) {
        uint32_t bits[2] = {0U, 0U};
        in.tick = k;
        in.torque = (law_real)((k > 100U) ? 0.0625F : 0.0F);
        in.reference = (law_real)((k > 50000U) ? 0.5F : 0.0F);
        in.reference_acceleration = (law_real)(((k > 50000U) && (k < 50050U)) ? 30.0F : 0.0F);
        in.motor_angle = (k < 2U) ? (law_real)0 : state.model_angle; /* a motor exactly as its model */
        law_step(&state, &law_data, &in, &out);
        (void)memcpy(bits, &out.motor_reference, sizeof(law_real));
        hash = (((hash ^ bits[0]) * 16777619U) ^ bits[1]) * 16777619U;
        if (k == 49999U) {
            require(out.motor_reference == (law_real)0); /* the offset has gone to the last bit */
        }
    }
    /* in the middle of the move the gauge stands still, which is seen */
    require((out.mode == LAW_DEGRADED) && (out.reason == LAW_GAUGE_STUCK));
    return hash;
}

/* A blocked link trips, an encoder that does not follow trips; slow enough for every other check. */
static void trips(void)
{
    law_state state;
    law_input in = {0};
    law_output out;
    require(law_init(&state, &law_data) == LAW_OK);
    for (uint32_t k = 1U; k < 400U; k++) {
        in.tick = k;
        in.torque = (law_real)((k < 160U) ? k : 160U) / (law_real)64;
        in.motor_angle = (k < 2U) ? (law_real)0 : state.model_angle; /* a motor exactly as its model */
        law_step(&state, &law_data, &in, &out);
    }
    require((out.mode == LAW_HOLD) && (out.reason == LAW_OVERLOAD));
    require(law_init(&state, &law_data) == LAW_OK);
    in.torque = (law_real)0;
    for (uint32_t k = 1U; k < 400U; k++) {
        in.tick = k;
        in.motor_angle = (law_real)(k & 1U) / (law_real)4096; /* alive, but it does not follow */
        in.reference = (law_real)((k < 100U) ? k : 100U) / (law_real)64;
        law_step(&state, &law_data, &in, &out);
    }
    require((out.mode == LAW_OFF) && (out.reason == LAW_RESIDUAL) && (out.voltage == (law_real)0));
    in.tick += 2U;
    law_step(&state, &law_data, &in, &out);
    require(out.mode == LAW_OFF);
}

static law_state state;
static law_input in;
static law_output out;

/* An arm that has stood at `angle` for some periods. */
static void begin(law_real angle)
{
    (void)memset(&in, 0, sizeof(in));
    in.reference = angle;
    in.motor_angle = angle;
    require(law_init(&state, &law_data) == LAW_OK);
    for (uint32_t k = 1U; k < 10U; k++) {
        in.tick = k;
        law_step(&state, &law_data, &in, &out);
    }
    require((out.mode == LAW_RUN) && (out.flags == 0U));
}

static void step(uint32_t periods)
{
    in.tick += periods;
    law_step(&state, &law_data, &in, &out);
}

static void clocks(void)
{
    begin((law_real)0.25F);
    step(law_data.missed_limit + 1U);
    require((out.mode == LAW_RUN) && (out.flags == LAW_FLAG_MISSED));
    step(law_data.missed_limit + 2U);
    require((out.mode == LAW_OFF) && (out.reason == LAW_MISSED));
    begin((law_real)0.25F);
    in.reference = (law_real)0.27F;
    step(0U);
    require(out.flags == LAW_FLAG_REPEATED);
    step((uint32_t)-3);
    require((out.flags == LAW_FLAG_REPEATED) && (out.motor_reference == (law_real)0.25F));
    begin((law_real)0.25F);
    in.motor_angle += law_data.angle_step * (law_real)1.5F;
    in.torque += law_data.torque_step * (law_real)1.5F;
    step(2U);
    require((out.flags & (LAW_FLAG_ENCODER | LAW_FLAG_GAUGE)) == 0U);
    in.motor_angle += law_data.angle_step * (law_real)1.5F;
    in.torque += law_data.torque_step * (law_real)1.5F;
    step(1U);
    require((out.flags & LAW_FLAG_ENCODER) != 0U);
    require((out.flags & LAW_FLAG_GAUGE) != 0U);
    /* a clock that stands: the voltage is held for as long as periods may be missed, and then no longer */
    begin((law_real)0.25F);
    in.reference = (law_real)0.27F;
    step(1U);
    require(out.voltage != (law_real)0);
    for (uint32_t k = 0U; k < law_data.missed_limit; k++) {
        step(0U);
        require((out.mode == LAW_RUN) && (out.voltage != (law_real)0));
    }
    step(0U);
    require((out.mode == LAW_OFF) && (out.reason == LAW_MISSED) && (out.voltage == (law_real)0));
    begin((law_real)0.25F); /* called twice in every period: the count begins anew in each */
    for (uint32_t k = 0U; k < 50U; k++) {
        step(1U);
        step(0U);
        require(out.mode == LAW_RUN);
    }
    /* memory that says "started" and "idle" at once: idle for a period, then a start */
    begin((law_real)0.25F);
    state.mode = LAW_IDLE;
    step(1U);
    require(out.mode == LAW_IDLE);
    step(1U);
    require((out.mode == LAW_RUN) && ((out.flags & LAW_FLAG_STARTED) != 0U));
}

/* One flipped bit of what decides whether the drive runs: it neither starts a drive that is off nor stops one that runs. */
static void upsets(void)
{
    for (uint32_t bit = 0U; bit < 32U; bit++) {
        for (uint32_t mode = LAW_RUN; mode <= LAW_OFF; mode++) {
            begin((law_real)0.25F);
            state.mode = in_each_byte(mode);
            state.stamp ^= 1U << bit;
            step(1U);
            require(out.mode == mode);
            state.mode ^= 1U << bit;
            step(1U);
            require((out.mode == mode) && (state.stamp == law_data.crc));
            state.mode ^= 1U << bit; /* both at once */
            state.stamp ^= 1U << (31U - bit);
            step(1U);
            require((out.mode == mode) || (mode == LAW_RUN));
            for (uint32_t second = 0U; second < bit; second++) { /* two bits of the mode: off, never back on */
                begin((law_real)0.25F);
                state.mode = in_each_byte(mode) ^ (1U << bit) ^ (1U << second);
                step(1U);
                require(out.mode == LAW_OFF);
            }
        }
        begin((law_real)0.25F);
        state.tick ^= 1U << bit;
        for (uint32_t k = 0U; k < 10U; k++) {
            in.reference += law_data.reference_step / (law_real)8;
            step(1U);
        }
        require((out.mode == LAW_OFF) || (out.motor_reference > (law_real)0.25F));
    }
    begin((law_real)0.25F); /* parameters that went bad are not run on, tripped or not */
    law_params block = law_data;
    block.crc ^= 1U;
    state.mode = in_each_byte(LAW_HOLD);
    in.tick++;
    law_step(&state, &block, &in, &out);
    require((out.mode == LAW_IDLE) && (out.reason == LAW_BAD_CRC));
}

static void limits(void)
{
    begin(law_data.motor_limit - (law_real)0.01F);
    in.reference_acceleration = (law_real)30;
    for (uint32_t k = 0U; k < 5U; k++) {
        step(1U);
        require(out.motor_reference <= law_data.motor_limit);
    }
    begin((law_real)0.25F);
    in.reference = (law_real)NAN;
    step(1U);
    require(out.flags == LAW_FLAG_REFERENCE);
    in.reference = (law_real)0.75F;
    step(1U);
    require((out.flags & LAW_FLAG_REFERENCE) != 0U);
    /* a motor that cannot follow: the voltage saturates, and leaves its limit as soon as the error turns */
    begin((law_real)0);
    in.motor_angle = (law_real)-0.0625F;
    for (uint32_t k = 0U; k < 4000U; k++) {
        step(1U);
    }
    require((out.voltage == law_data.voltage_limit) && ((out.flags & LAW_FLAG_SATURATED) != 0U));
    in.motor_angle = (law_real)0.0625F;
    for (uint32_t k = 0U; k < 50U; k++) {
        step(1U);
    }
    require(out.voltage < law_data.voltage_limit);
}

static void memory(void)
{
    begin((law_real)0.25F);
    state.real[0] = (law_real)1e20F;
    state.forward[0] = (law_real)1e6F;
    state.forward[1] = (law_real)1000;
    seal(&state, &law_data); /* modes that no input explains, but that the last period left */
    step(1U);
    require((state.real[0] == (law_real)0) && (state.forward[0] == (law_real)0) && (state.forward[1] > (law_real)500));
    require((out.flags & LAW_FLAG_STARTED) == 0U);
    begin((law_real)0.25F);
    const law_real holding = state.integral;
    state.integral = (law_real)1e6F;
    seal(&state, &law_data);
    step(1U);
    require(fabs((double)(state.integral - holding)) < 1.0); /* begun anew, as for an arm at rest */
    require((out.flags & LAW_FLAG_STARTED) == 0U);
    /* what the last period did not leave: the arm begins anew where it stands, and in the mode that it was in */
    for (uint32_t mode = LAW_RUN; mode <= LAW_OFF; mode++) {
        for (uint32_t i = 0U; i < 9U; i++) {
            begin((law_real)0.25F);
            law_real *const damage[9] = {&state.real[0], &state.forward[1], &state.reference, &state.motor_reference,
                                         &state.integral, &state.torque, &state.error, &state.scale, &state.sum};
            state.mode = in_each_byte(mode);
            *damage[i] += (law_real)0.0078125F;
            step(1U);
            require((out.mode == mode) && ((out.flags & LAW_FLAG_STARTED) != 0U));
            require(out.motor_reference == (law_real)0.25F);
            step(1U);
            require((out.mode == mode) && (out.flags == 0U) && (out.motor_reference == (law_real)0.25F));
        }
    }
    begin((law_real)0.25F);
    state.real[0] = (law_real)NAN;
    state.error = (law_real)NAN;
    state.motor_angle = (law_real)NAN;
    state.torque = (law_real)NAN;
    state.model_push = (law_real)1e20F;
    state.reference = (law_real)1e20F;
    state.encoder_model = (law_real)NAN;
    step(1U);
    step(1U);
    require((out.mode == LAW_RUN) && (fabs((double)out.motor_reference - 0.25) < 0.01));
    require((state.reference == (law_real)0.25F) && (state.model_angle == (law_real)0.25F));
    require((state.real[0] == (law_real)0) && (state.encoder_model == state.model_angle));
    begin((law_real)0.25F);
    state.encoder = (law_real)NAN;
    state.encoder_model = (law_real)-1;
    step(1U);
    require((state.encoder == in.motor_angle) && (state.encoder_model == (law_real)0.25F) && (out.flags == 0U));
    begin((law_real)0.25F);
    state.bad_gauge = 0x7FFFFFFFU;
    in.torque = (law_real)NAN;
    step(1U);
    require(state.bad_gauge == 0x7FFFFFFFU); /* a counter does not wrap around */
    begin((law_real)0.25F);
    state.motor_reference = (law_real)NAN;
    step(1U);
    require(out.motor_reference == (law_real)0.25F);
    begin((law_real)0.25F);
    state.model_angle = (law_real)2 * law_data.motor_limit;
    step(1U);
    require((out.mode == LAW_RUN) && (state.model_angle == (law_real)0.25F));
}

/* The flags of a tip that swings in `block` until the law stops it, or for thirty half periods. */
static uint32_t swing(const law_params *block)
{
    const law_real torque = (law_real)2 * block->swing_angle * block->stiffness;
    uint32_t flags = 0U;
    begin((law_real)0);
    state.stamp = block->crc;
    for (uint32_t k = 0U; (k < (30U * block->block_limit)) && (out.mode == LAW_RUN); k++) {
        const law_real wanted = (((k / block->block_limit) & 1U) != 0U) ? torque : -torque;
        in.torque += (wanted - in.torque) / (law_real)8;
        in.motor_angle = state.model_angle;
        in.tick++;
        law_step(&state, block, &in, &out);
        flags |= out.flags;
    }
    return flags;
}

/* A vibration that does not decay is flagged; where a limit was given, it trips. */
static void vibrations(void)
{
    law_params block = law_data;
    block.options &= ~LAW_STOP_RINGING;
    block.crc = crc_32(&block);
    require(((swing(&block) & LAW_FLAG_RINGING) != 0U) && (out.mode == LAW_RUN));
    block.options |= LAW_STOP_RINGING;
    block.crc = crc_32(&block);
    require(((swing(&block) & LAW_FLAG_RINGING) != 0U) && (out.mode == LAW_HOLD) && (out.reason == LAW_RINGING));
}

/* A jump of the reference is followed slowly, its own motion beneath it at once, a little that is left at once. */
static void jumps(void)
{
    begin((law_real)0);
    in.reference = (law_real)0.5F;
    step(1U);
    const law_real first = state.reference;
    require((first > (law_real)0) && (first < (law_real)0.05F * in.reference));
    in.reference += law_data.reference_step / (law_real)2;
    step(1U);
    const law_real behind = law_data.reference_rate * ((law_real)0.5F - first);
    require(fabs((double)(((state.reference - first) - (law_data.reference_step / (law_real)2)) - behind)) < 1e-6);
    require((out.flags & LAW_FLAG_REFERENCE) != 0U);
    for (uint32_t k = 0U; k < 2000U; k++) {
        in.motor_angle = state.model_angle;
        step(1U);
    }
    require((state.reference == in.reference) && (out.flags == 0U));
    in.reference += law_data.reference_step * (law_real)1.5F;
    step(1U);
    require((out.flags & LAW_FLAG_REFERENCE) != 0U);
    require(fabs((double)((in.reference - state.reference) - (law_data.reference_step / (law_real)2))) < 1e-6);
    in.reference += law_data.reference_step;
    step(2U);
    require(state.reference == in.reference); /* the time between was there to move in */
}

/* An encoder that stands still to the count while the motor moves: the model stands in for it, then the drive is off. */
static void frozen(void)
{
    begin((law_real)0);
    uint32_t periods = 0U;
    for (uint32_t k = 1U; (k < 200U) && (out.mode == LAW_RUN); k++) {
        in.reference += law_data.reference_step / (law_real)2;
        in.torque = (law_real)(k & 1U) / (law_real)1024;
        step(1U);
        periods += ((out.flags & LAW_FLAG_ENCODER) != 0U) ? 1U : 0U;
        if ((out.flags & LAW_FLAG_ENCODER) != 0U) {
            require(state.motor_angle > law_data.frozen_angle);
        }
    }
    require((out.mode == LAW_OFF) && (out.reason == LAW_RESIDUAL) && (periods == (law_data.frozen_limit - 1U)));
    begin((law_real)0); /* one that lives again in time is taken back */
    for (uint32_t k = 1U; k < law_data.frozen_limit; k++) {
        in.reference += law_data.reference_step / (law_real)2;
        step(1U);
    }
    in.motor_angle = state.model_angle;
    step(1U);
    require((out.mode == LAW_RUN) && (state.frozen == 0U) && (state.motor_angle == in.motor_angle));
}

/* A torque that no vibration takes back holds, though it is far below that of a hard stop. */
static void blocked(void)
{
    begin((law_real)0);
    uint32_t periods = 0U;
    for (uint32_t k = 1U; (k < 2000U) && (out.mode == LAW_RUN); k++) {
        const law_real torque = (law_data.torque_block * (law_real)1.1F) + ((law_real)(k & 1U) / (law_real)1024);
        in.torque += (torque - in.torque) / (law_real)8;
        in.motor_angle = state.model_angle;
        step(1U);
        periods += (in.torque > law_data.torque_block) ? 1U : 0U;
    }
    require((out.mode == LAW_HOLD) && (out.reason == LAW_OVERLOAD) && (periods == law_data.block_limit));
}

static void held(void)
{
    begin((law_real)0);
    for (uint32_t k = 1U; k < 300U; k++) {
        in.torque = (law_real)((k < 160U) ? k : 160U) / (law_real)64;
        in.motor_angle = state.model_angle;
        step(1U);
        require((out.mode == LAW_RUN) || (in.torque >= law_data.torque_trip));
        require((out.mode == LAW_HOLD) || (in.torque < (law_data.torque_trip + (law_real)0.05F)));
    }
    require((out.mode == LAW_HOLD) && (out.reason == LAW_OVERLOAD));
    const law_real place = out.motor_reference;
    in.reference = (law_real)0.5F;
    for (uint32_t k = 1U; k < 50U; k++) {
        in.motor_angle = state.model_angle;
        step(1U);
        require(out.motor_reference == place);
    }
    /* a gauge that stands still in a move is given up, and not before its count is full */
    begin((law_real)0);
    uint32_t moved = 0U;
    for (uint32_t k = 1U; (k < 200U) && (out.mode == LAW_RUN); k++) {
        in.reference_acceleration = (law_real)30;
        in.motor_angle = (k < 5U) ? (law_real)0 : state.model_angle;
        step(1U);
        require((k >= 5U) || (state.stuck == 0U)); /* friction holds the motor, and with it the torque */
        moved++;
    }
    require((out.reason == LAW_GAUGE_STUCK) && (moved >= law_data.stuck_limit) && (moved < 100U));
}

/* The payload: taken where it can be, counted on at once at the start, slowly afterwards, and forgotten in time. */
static void payloads(void)
{
    const law_real nominal = law_data.payload_limit / (law_real)4;
    begin((law_real)0.25F);
    in.payload = nominal;
    step(1U);
    require((out.flags == 0U) && (state.given == 1U) && (state.tracking == 1U));
    in.payload = (law_real)3 * nominal;
    step(1U);
    require((out.flags == 0U) && (state.scale < ((law_real)1.5F)));
    for (uint32_t k = 0U; k < 200U; k++) {
        in.payload = (law_real)3 * nominal;
        step(1U);
    }
    require((state.scale > (law_real)2.9F) && (state.payload == in.payload));
    in.reference = (law_real)0.27F; /* the model is behind when the payload goes, and stays until it has caught up */
    step(1U);
    step(1U);
    in.payload = (law_real)0;
    step(1U);
    require((state.given == 0U) && (state.tracking == 1U));
    for (uint32_t k = 0U; k < 300U; k++) {
        step(1U);
    }
    require((state.tracking == 0U) && (state.scale == (law_real)1));
    in.payload = (law_real)2 * law_data.payload_limit;
    step(1U);
    require((out.flags == LAW_FLAG_PAYLOAD) && (state.given == 0U));
    in.payload = (law_real)NAN;
    step(1U);
    require((out.flags == LAW_FLAG_PAYLOAD) && (state.given == 0U));
    in.payload = nominal;
    step(1U);
    state.track = (law_real)NAN; /* damaged memory */
    step(1U);
    require((out.error == out.error) && (state.track == state.track));
    state.scale = (law_real)1e9F;
    in.reference_acceleration = (law_real)1;
    step(1U);
    step(1U);
    require((out.flags & LAW_FLAG_PAYLOAD) == 0U);
    require((state.scale < (law_real)1.1F) && (state.scale > (law_real)0.9F));
    /* a gauge that is late: while the feed-forward bends the link, the error counts on a reading that lags */
    law_params late = law_data;
    late.options |= LAW_LATE_GAUGE;
    late.gauge_now = (law_real)0.125F;
    late.gauge_keep = (law_real)0.875F;
    late.crc = crc_32(&late);
    begin((law_real)0);
    law_state other = state;
    other.stamp = late.crc;
    in.payload = nominal;
    law_output seen;
    for (uint32_t k = 0U; k < 10U; k++) {
        in.reference_acceleration = (law_real)1;
        in.tick++;
        law_step(&state, &law_data, &in, &out);
        law_step(&other, &late, &in, &seen);
    }
    require(seen.error > out.error);
}

int main(int count, char **words)
{
    const long runs = (count > 1) ? strtol(words[1], NULL, 10) : 1000L;
    static unsigned char bytes[2048];
    refusals();
    wiring();
    trips();
    clocks();
    upsets();
    limits();
    memory();
    vibrations();
    jumps();
    frozen();
    blocked();
    held();
    payloads();
    const uint32_t hash = quiet();
    for (long i = 0; i < runs; i++) {
        for (size_t j = 0; j < sizeof(bytes); j++) {
            bytes[j] = next_byte();
        }
        (void)LLVMFuzzerTestOneInput(bytes, sizeof(bytes));
    }
    (void)printf("hash %08lX\n", (unsigned long)hash);
    return 0;
}

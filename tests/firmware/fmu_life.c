/* The life of an FMU, right and wrong, for the sanitizers. Build in the FMU's sources. */
#include "all.c"

static int told; /* messages so far */

static int failed(const char *what)
{
    printf("failed: %s\n", what);
    return 1;
}

typedef fmi3Instance component;
#define CALL(name) fmi3##name
static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment, (void)status, (void)category, (void)message;
    told++;
}
static component make(const char *token)
{
    return fmi3InstantiateCoSimulation("arm", token, NULL, false, true, false, false, NULL, 0, NULL, hear, NULL);
}
static int initialize(component me)
{
    return fmi3EnterInitializationMode(me, false, 0.0, 0.0, false, 0.0) || fmi3ExitInitializationMode(me);
}
static int step(component me, double now, double size)
{
    bool event, end, early;
    double reached;
    return fmi3DoStep(me, now, size, true, &event, &end, &early, &reached);
}
static int set(component me, const uint32_t r[], size_t n, const double v[]) { return fmi3SetFloat64(me, r, n, v, n); }
static int get(component me, const uint32_t r[], size_t n, double v[]) { return fmi3GetFloat64(me, r, n, v, n); }
#define STATE(name) fmi3##name##FMUState
#define RESTORE fmi3DeserializeFMUState
#define SIZE_OF fmi3SerializedFMUStateSize
#define WRITE fmi3SerializeFMUState
typedef fmi3Byte byte;

int main(void)
{
    static const double inputs[][4] = {{0.1, 0.0, 0.05, 0.01}, {1e300, -1e300, 1e300, -1e300}};
    static const uint32_t references[4] = {0, 1, 2, 3}, outputs[3] = {4, 5, 6}, wrong[1] = {77};
    double values[4];
    byte stored[4096];
    size_t size = 0;
    void *state = NULL, *copy = NULL;
    component first, second;
    if (make("{not this one}") != NULL || make(NULL) != NULL || told != 2)
        return failed("a wrong token");
    CALL(FreeInstance)(NULL);
    first = make(FMU_TOKEN);
    second = make(FMU_TOKEN);
    if (first == NULL || second == NULL || initialize(first) || initialize(second))
        return failed("instances");
    for (int k = 0; k < 500; k++) {
        if (set(first, references, 4, inputs[k % 97 == 96]) || step(first, k * FMU_PERIOD, FMU_PERIOD) ||
            get(first, outputs, 3, values))
            return failed("a step");
        if (!(values[0] >= -1e3 && values[0] <= 1e3))
            return failed("an output beyond its limit");
        if (k == 250 && STATE(Get)(first, &state))
            return failed("a snapshot");
    }
    if (STATE(Get)(first, &state) || SIZE_OF(first, state, &size) || size > sizeof stored)
        return failed("a second snapshot into the first");
    if (WRITE(first, state, stored, size) || RESTORE(second, stored, size, &copy) || STATE(Set)(second, copy))
        return failed("a state in another instance");
    if (step(second, 500 * FMU_PERIOD, FMU_PERIOD))
        return failed("a step after it");
    told = 0;
    if (!step(second, 0.0, 1.0) || !get(second, wrong, 1, values) || !set(second, wrong, 1, values) ||
        !RESTORE(second, stored, size - 1, &copy) || !WRITE(second, state, stored, 1) || !STATE(Set)(second, NULL))
        return failed("an error that is none");
    if (told != 6)
        return failed("an error that is not told");
    if (CALL(Reset)(second) || initialize(second) || CALL(Terminate)(second))
        return failed("a second life");
    (void)STATE(Free)(first, &state);
    (void)STATE(Free)(first, &copy);
    CALL(FreeInstance)(first);
    CALL(FreeInstance)(second);
    return state != NULL || copy != NULL ? failed("a snapshot that is left") : (puts("lived"), 0);
}

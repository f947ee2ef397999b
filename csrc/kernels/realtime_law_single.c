/* realtime_law.c around the single-precision law. */
#include "law_single.h"
#define REALTIME_LAW realtime_law_single
#define REALTIME_ESTIMATE realtime_estimate_single
#include "realtime_law.c"

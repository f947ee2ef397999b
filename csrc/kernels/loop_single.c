/* loop.c around the single-precision law. */
#include "law_single.h"
#define LOOP_RUN loop_run_single
#include "loop.c"

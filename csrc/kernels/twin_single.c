/* twin_law.c around the single-precision law. */
#include "law_single.h"
#define TWIN_RUN twin_run_single
#define TWIN_SIZES twin_sizes_single
#include "twin_law.c"

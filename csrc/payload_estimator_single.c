/* Desktop only: payload_estimator.c in single precision, under names of its own (see law_single.h). */
#include "law_single.h"
/* The names are set before the file itself is read, so that it stays the file that is shipped. */
#include "payload_estimator.c"

/* Desktop only: names of the single-precision build of law.c, which lives beside the double one in the package. */
#ifndef FRACLINK_LAW_SINGLE_H
#define FRACLINK_LAW_SINGLE_H

#define LAW_SINGLE
#define law_check law_check_single
#define law_init law_init_single
#define law_step law_step_single
#define law_check_wiring law_check_wiring_single
#define payload_check payload_check_single
#define payload_init payload_init_single
#define payload_step payload_step_single

#endif

/* Start-up of the emulated boards (MPS2: code at 0, RAM at 0x20000000); output goes through semihosting. */
#include <stdint.h>

extern uint32_t stack_top;
extern void initialise_monitor_handles(void);
extern int main(void);
extern void exit(int code);

/* newlib calls these at exit; there are no constructors to undo. */
void _init(void) {}
void _fini(void) {}

__attribute__((noreturn)) void reset(void)
{
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20U; /* CPACR: full access to the FPU */
    __asm volatile("dsb\nisb");
#endif
    initialise_monitor_handles();
    exit(main());
}

__attribute__((noreturn)) static void fault(void)
{
    exit(99);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)fault, (const void *)fault, (const void *)fault,
    (const void *)fault, (const void *)fault, 0, 0, 0, 0, (const void *)fault, (const void *)fault, 0,
    (const void *)fault, (const void *)fault};

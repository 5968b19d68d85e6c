// Which kernels this machine can run.
#include "types.h"

namespace sgm {

extern const Kernel kernel_plain;
#if defined(SGM_X86)
extern const Kernel kernel_sse41;
extern const Kernel kernel_avx2;
extern const Kernel kernel_avx512;
#elif defined(SGM_ARM64)
extern const Kernel kernel_neon;
#endif

static int list_kernels(Kernel* out) {
  int n = 0;
#if defined(SGM_X86)
  __builtin_cpu_init();
  const bool wide = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                    __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vpopcntdq") &&
                    __builtin_cpu_supports("avx512bitalg") && __builtin_cpu_supports("bmi2") &&
                    __builtin_cpu_supports("avx512vbmi");
  if (wide) out[n++] = kernel_avx512;
  if (__builtin_cpu_supports("avx2")) out[n++] = kernel_avx2;
  if (__builtin_cpu_supports("sse4.1")) out[n++] = kernel_sse41;
#elif defined(SGM_ARM64)
  out[n++] = kernel_neon;
#endif
  out[n++] = kernel_plain;
  return n;
}

const Kernel* kernels(int* number) {
  static Kernel list[5];
  static const int n = list_kernels(list);
  *number = n;
  return list;
}

}  // namespace sgm

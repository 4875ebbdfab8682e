/** Adaptive integers on top of the range decoder: spec/cndhf.md, section 4.2. */
import { type RangeDecoder, Context, contexts } from "./rangeCoder.js";

const MAX_DIGITS = 21;

export class UnsignedModel {
  private readonly digits = contexts(MAX_DIGITS);
  private readonly below = contexts(4 * MAX_DIGITS);

  read(coder: RangeDecoder): number {
    let digits = 1;
    while (digits < MAX_DIGITS && coder.bit(this.digits[digits]!)) digits++;
    const learnt = Math.min(digits - 1, 2);
    let value = 1;
    for (let k = 0; k < learnt; k++) value = 2 * value + coder.bit(this.below[4 * (digits - 1) + value]!);
    const rest = digits - 1 - learnt;
    return value * 2 ** rest + coder.raw(rest) - 1;
  }
}

export class SignedModel {
  private readonly nonzero = new Context();
  private readonly negative = new Context();
  private readonly magnitude = new UnsignedModel();

  read(coder: RangeDecoder): number {
    if (!coder.bit(this.nonzero)) return 0;
    const negative = coder.bit(this.negative);
    const value = 1 + this.magnitude.read(coder);
    return negative ? -value : value;
  }
}

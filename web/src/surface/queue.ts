/** First in, first out, of numbers from 0. */
export class Queue {
  private readonly items: number[] = [];
  private at = 0;

  push(item: number): void {
    this.items.push(item);
  }

  /** Takes items out, one after the other, those that are added meanwhile too. */
  *[Symbol.iterator](): Generator<number> {
    while (this.at < this.items.length) yield this.items[this.at++]!;
  }
}

/** Meshes made in workers, so that a page stays responsive. */
import * as cndhf from "./index.js";

export interface Question {
  id: number;
  bytes: Uint8Array;
  options: object;
}

export interface Answer {
  id: number;
  mesh?: cndhf.Mesh;
  error?: { name: string; message: string };
}

/** A worker could not be started, or broke. */
export class WorkerError extends Error {}

interface Job {
  resolve(mesh: cndhf.Mesh): void;
  reject(error: Error): void;
}

export class MeshWorkers {
  private readonly workers: Worker[] = [];
  private readonly busy: number[] = []; // jobs of each worker
  private readonly jobs = new Map<number, Job>();
  private count = 0;

  /** At most `limit` workers, started when they are needed. `start` makes one; by default dist/worker.js. */
  constructor(
    private readonly limit: number,
    private readonly start = (): Worker => new Worker(new URL("./worker.js", import.meta.url), { type: "module" }),
  ) {}

  /** The mesh of a file. Rejected with the CndhfError that decoding it gives, or with a WorkerError. */
  mesh(bytes: Uint8Array, options: object): Promise<cndhf.Mesh> {
    return new Promise((resolve, reject) => {
      const id = this.count++;
      this.jobs.set(id, { resolve, reject });
      const k = this.least();
      this.busy[k]!++;
      this.workers[k]!.postMessage({ id, bytes, options } satisfies Question);
    });
  }

  /** End the workers; what they have not done is rejected. */
  dispose(): void {
    for (const worker of this.workers.splice(0)) worker.terminate();
    this.busy.length = 0;
    this.fail(new Error("the workers were ended"));
  }

  /** The worker with the fewest jobs, or a new one. */
  private least(): number {
    const least = this.busy.indexOf(Math.min(...this.busy));
    if (least >= 0 && (this.busy[least] === 0 || this.workers.length >= this.limit)) return least;
    let worker: Worker;
    try {
      worker = this.start();
    } catch (error) {
      throw new WorkerError(String(error)); // browsers refuse a script of another origin
    }
    const k = this.workers.push(worker) - 1;
    this.busy.push(0);
    worker.onmessage = ({ data }: MessageEvent<Answer>) => {
      this.busy[k]!--;
      const job = this.jobs.get(data.id);
      this.jobs.delete(data.id);
      if (data.mesh) job?.resolve(data.mesh);
      else job?.reject(revived(data.error!));
    };
    worker.onerror = (event) => this.fail(new WorkerError(event.message || "a worker could not be started"));
    return k;
  }

  private fail(error: Error): void {
    for (const job of this.jobs.values()) job.reject(error);
    this.jobs.clear();
  }
}

/** An error of the class that its name says. */
function revived({ name, message }: { name: string; message: string }): Error {
  const found = (cndhf as Record<string, unknown>)[name] as (new (message: string) => Error) | undefined;
  return found?.prototype instanceof Error ? new found(message) : new Error(message);
}

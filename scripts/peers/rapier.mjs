// Rapier in Node: balls of restitution 1 between cuboids. Commands and answers are lines of JSON.
//
// While impulses are counted the walls are heavy bodies that are brought back to rest and place after each frame: what
// each gained is the impulse on it.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { createInterface } from "node:readline";

const HEAVY = 1e8; // mass of a counted wall [masses of a disc]
const DISCS = 0x0001_0003, WALLS = 0x0002_0001; // who is in a group, who it meets

const [, , modules, name] = process.argv;
const loaded = createRequire(`${modules}/`)(name);
const RAPIER = loaded.default ?? loaded;
await RAPIER.init();

let world, discs, walls, plan, impulse;

function prepare(start) {
    plan = start;
    impulse = [0, 0, 0, 0];
    world = new RAPIER.World({ x: 0, y: 0 });
    world.timestep = plan.dt;
    world.numSolverIterations = plan.knob;
    const bytes = readFileSync(plan.path);
    const numbers = new Float64Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 8);
    discs = [];
    for (let i = 0; i < numbers.length; i += 4) {
        const kind = RAPIER.RigidBodyDesc.dynamic().setTranslation(numbers[i], numbers[i + 1]);
        kind.setLinvel(numbers[i + 2], numbers[i + 3]).setCanSleep(false).lockRotations();
        const body = world.createRigidBody(kind);
        const ball = RAPIER.ColliderDesc.ball(plan.radius).setRestitution(1).setFriction(0).setMass(1);
        world.createCollider(ball.setCollisionGroups(DISCS), body);
        discs.push(body);
    }
    const thick = 4 * plan.radius, w = plan.width, h = plan.height;
    const places = [[-thick, h / 2], [w + thick, h / 2], [w / 2, -thick], [w / 2, h + thick]];
    const halves = [[thick, h / 2 + 2 * thick], [thick, h / 2 + 2 * thick], [w / 2 + 2 * thick, thick], [w / 2 + 2 * thick, thick]];
    walls = places.map(([x, y], i) => {
        const kind = plan.counting ? RAPIER.RigidBodyDesc.dynamic().lockRotations() : RAPIER.RigidBodyDesc.fixed();
        const body = world.createRigidBody(kind.setTranslation(x, y));
        const box = RAPIER.ColliderDesc.cuboid(...halves[i]).setRestitution(1).setFriction(0).setMass(HEAVY);
        world.createCollider(box.setCollisionGroups(WALLS), body);
        return { body, place: { x, y } };
    });
}

function run(frames) {
    for (let frame = 0; frame < frames; ++frame) {
        world.step();
        if (!plan.counting) continue;
        walls.forEach(({ body, place }, i) => {
            const speed = body.linvel();
            impulse[i] += HEAVY * Math.abs(i < 2 ? speed.x : speed.y);
            body.setLinvel({ x: 0, y: 0 }, true);
            body.setTranslation(place, true);
        });
    }
}

function state() {
    return discs.map((body) => {
        const x = body.translation(), v = body.linvel();
        return [x.x, x.y, v.x, v.y];
    });
}

for await (const line of createInterface({ input: process.stdin })) {
    const command = JSON.parse(line);
    let answer = null;
    if (command.do === "prepare") prepare(command);
    else if (command.do === "run") run(command.frames);
    else if (command.do === "state") answer = state();
    else if (command.do === "walls") answer = impulse;
    process.stdout.write(JSON.stringify(answer) + "\n");
}

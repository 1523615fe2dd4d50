import { startSpheres } from "./sphere.js";

startSpheres();

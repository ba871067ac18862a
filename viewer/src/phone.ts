// Starts the page that makes a phone a sensor.

import { mount } from "svelte";
import "./theme.css";
import Phone from "./phone/Phone.svelte";

mount(Phone, { target: document.getElementById("app")! });
